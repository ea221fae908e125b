/* Who runs: START, SET_PRIORITY, SUSPEND, RESUME, STOP, DELAYED_START, and the preemption lock. */
#include "partition.h"

static char trace[64];
static PROCESS_ID_TYPE low, high, sleeper;

static void mark(char what) {
    size_t length = strlen(trace);
    if (length + 1 < sizeof trace) trace[length] = what;
}

static void run_high(void) { mark('H'); }

static void run_sleeper(void) {
    mark('s');
    EXPECT(TIMED_OUT, SUSPEND_SELF(40 * MS, &code));
    mark('t');
    EXPECT(NO_ERROR, SUSPEND_SELF(INFINITE_TIME_VALUE, &code));
    mark('r');
    /* It is stopped here, and begins again. */
    EXPECT(NO_ERROR, SUSPEND_SELF(INFINITE_TIME_VALUE, &code));
    mark('!');
}

static void run_low(void) {
    LOCK_LEVEL_TYPE level = 0;
    PROCESS_STATUS_TYPE status;
    int turn;
    mark('L');
    EXPECT(NO_ERROR, START(high, &code));
    mark('l');
    EXPECT(NO_ERROR, LOCK_PREEMPTION(&level, &code));
    CHECK(level == 1);
    EXPECT(NO_ERROR, START(high, &code));
    EXPECT(NO_ACTION, START(high, &code));
    EXPECT(INVALID_MODE, TIMED_WAIT(0, &code));
    mark('k');
    EXPECT(NO_ERROR, UNLOCK_PREEMPTION(&level, &code));
    CHECK(level == 0);
    EXPECT(NO_ACTION, UNLOCK_PREEMPTION(&level, &code));
    EXPECT(NO_ERROR, TIMED_WAIT(60 * MS, &code));
    EXPECT(NO_ERROR, RESUME(sleeper, &code));
    EXPECT(NO_ERROR, GET_PROCESS_STATUS(sleeper, &status, &code));
    CHECK(status.PROCESS_STATE == WAITING);
    for (turn = 0; turn < 3; turn++) {
        EXPECT(NO_ERROR, STOP(sleeper, &code));
        EXPECT(NO_ACTION, STOP(sleeper, &code));
        EXPECT(NO_ERROR, DELAYED_START(sleeper, 10 * MS, &code));
        EXPECT(NO_ERROR, TIMED_WAIT(30 * MS, &code));
    }
    EXPECT(INVALID_MODE, SET_PRIORITY(high, 1, &code));
    EXPECT(NO_ERROR, SET_PRIORITY(low, 5, &code));
    if (strcmp(trace, "sLHlkHtrsss") != 0) say("FAILED %s", trace);
    say("done");
}

int main(void) {
    PROCESS_ATTRIBUTE_TYPE attributes;
    memset(&attributes, 0, sizeof attributes);
    attributes.PERIOD = attributes.TIME_CAPACITY = INFINITE_TIME_VALUE;
    attributes.ENTRY_POINT = run_high;
    attributes.STACK_SIZE = 16384;
    attributes.BASE_PRIORITY = 100;
    strcpy(attributes.NAME, "high");
    EXPECT(NO_ERROR, CREATE_PROCESS(&attributes, &high, &code));
    sleeper = begin("sleeper", run_sleeper, 50, 0);
    low = begin("low", run_low, 10, 0);
    return normal();
}
