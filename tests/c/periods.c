/* A partition that changes the module's schedule and looks what becomes of its period, its port, its memory and its permission. */
#include "partition.h"

static SAMPLING_PORT_ID_TYPE port;
static SCHEDULE_ID_TYPE schedules[2];
static unsigned windows;

static void watches(void) {
    SYSTEM_TIME_TYPE period = 0, duration = 0;
    while (1) {
        PARTITION_STATUS_TYPE status;
        EXPECT(NO_ERROR, GET_PARTITION_STATUS(&status, &code));
        if (status.PERIOD != period || status.DURATION != duration) {
            period = status.PERIOD;
            duration = status.DURATION;
            say("period %d ms, duration %d us", (int) (period / MS), (int) (duration / 1000));
        }
        windows++;
        EXPECT(NO_ERROR, WRITE_SAMPLING_MESSAGE(port, (MESSAGE_ADDR_TYPE) &windows, sizeof windows, &code));
        if (windows % 10 == 0) {
            SCHEDULE_STATUS_TYPE now;
            EXPECT(NO_ERROR, GET_MODULE_SCHEDULE_STATUS(&now, &code));
            EXPECT(NO_ERROR, SET_MODULE_SCHEDULE(schedules[now.CURRENT_SCHEDULE == schedules[0]], &code));
        }
        if (windows == 35) say("done");
        EXPECT(NO_ERROR, PERIODIC_WAIT(&code));
    }
}

int main(void) {
    EXPECT(NO_ERROR, GET_MODULE_SCHEDULE_ID("fast", &schedules[0], &code));
    EXPECT(NO_ERROR, GET_MODULE_SCHEDULE_ID("slow", &schedules[1], &code));
    EXPECT(NO_ERROR, CREATE_SAMPLING_PORT("out", 8, SOURCE, 1, &port, &code));
    begin("watches", watches, 10, 40 * MS);
    return normal();
}
