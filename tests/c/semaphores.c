/* Four workers share two places, and none is ever without a turn. */
#include "partition.h"

static SEMAPHORE_ID_TYPE places;
static int inside, most, turns[4];

static void work(int which) {
    for (;;) {
        EXPECT(NO_ERROR, WAIT_SEMAPHORE(places, INFINITE_TIME_VALUE, &code));
        inside++;
        if (inside > most) most = inside;
        EXPECT(NO_ERROR, TIMED_WAIT(20 * MS, &code));
        inside--;
        turns[which]++;
        EXPECT(NO_ERROR, SIGNAL_SEMAPHORE(places, &code));
    }
}

static void one(void) { work(0); }
static void two(void) { work(1); }
static void three(void) { work(2); }
static void four(void) { work(3); }

static void watch(void) {
    SEMAPHORE_STATUS_TYPE status;
    int which;
    EXPECT(NO_ERROR, TIMED_WAIT(800 * MS, &code));
    CHECK(most == 2);
    for (which = 0; which < 4; which++) CHECK(turns[which] >= 10);
    EXPECT(NO_ERROR, GET_SEMAPHORE_STATUS(places, &status, &code));
    CHECK(status.MAXIMUM_VALUE == 2 && status.CURRENT_VALUE <= 2);
    EXPECT(NOT_AVAILABLE, WAIT_SEMAPHORE(places, 0, &code));
    say("done");
}

int main(void) {
    EXPECT(NO_ERROR, CREATE_SEMAPHORE("places", 2, 2, FIFO, &places, &code));
    begin("one", one, 10, 0);
    begin("two", two, 11, 0);
    begin("three", three, 12, 0);
    begin("four", four, 13, 0);
    begin("watch", watch, 50, 0);
    return normal();
}
