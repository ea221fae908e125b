/* An event that lets three go on at once. */
#include "partition.h"

static EVENT_ID_TYPE event;
static int gone_on;

static void waiter(void) {
    EXPECT(NO_ERROR, WAIT_EVENT(event, INFINITE_TIME_VALUE, &code));
    gone_on++;
}

static void setter(void) {
    EVENT_STATUS_TYPE status;
    EXPECT(NO_ERROR, GET_EVENT_STATUS(event, &status, &code));
    CHECK(status.EVENT_STATE == DOWN && status.WAITING_PROCESSES == 3);
    EXPECT(NO_ERROR, SET_EVENT(event, &code));
    CHECK(gone_on == 3);
    EXPECT(NO_ERROR, WAIT_EVENT(event, 0, &code));
    EXPECT(NO_ERROR, RESET_EVENT(event, &code));
    EXPECT(NOT_AVAILABLE, WAIT_EVENT(event, 0, &code));
    EXPECT(TIMED_OUT, WAIT_EVENT(event, 30 * MS, &code));
    say("done");
}

int main(void) {
    EXPECT(NO_ERROR, CREATE_EVENT("go", &event, &code));
    begin("first", waiter, 30, 0);
    begin("second", waiter, 30, 0);
    begin("third", waiter, 20, 0);
    begin("setter", setter, 10, 0);
    return normal();
}
