/* Three processes with periods, and one without that uses what they leave. */
#include "partition.h"

static int counts[3];

static void round_of(int which, SYSTEM_TIME_TYPE period) {
    SYSTEM_TIME_TYPE now = 0, last = 0;
    for (;;) {
        EXPECT(NO_ERROR, GET_TIME(&now, &code));
        /* Others run first where they are released at once. */
        CHECK(last == 0 || (now - last > period - MS && now - last < period + MS));
        last = now;
        counts[which]++;
        EXPECT(NO_ERROR, PERIODIC_WAIT(&code));
    }
}

static void each_20(void) { round_of(0, 20 * MS); }
static void each_40(void) { round_of(1, 40 * MS); }
static void each_100(void) { round_of(2, 100 * MS); }

static void rest(void) {
    EXPECT(INVALID_MODE, PERIODIC_WAIT(&code));
    EXPECT(NO_ERROR, TIMED_WAIT(1000 * MS, &code));
    CHECK(counts[0] >= 49 && counts[0] <= 51);
    CHECK(counts[1] >= 24 && counts[1] <= 26);
    CHECK(counts[2] >= 9 && counts[2] <= 11);
    say("done");
}

int main(void) {
    PROCESS_ATTRIBUTE_TYPE attributes;
    PROCESS_ID_TYPE id;
    memset(&attributes, 0, sizeof attributes);
    attributes.PERIOD = 30 * MS;
    attributes.TIME_CAPACITY = INFINITE_TIME_VALUE;
    attributes.ENTRY_POINT = rest;
    attributes.STACK_SIZE = 16384;
    attributes.BASE_PRIORITY = 1;
    strcpy(attributes.NAME, "no multiple");
    EXPECT(INVALID_CONFIG, CREATE_PROCESS(&attributes, &id, &code));
    begin("each 20 ms", each_20, 30, 20 * MS);
    begin("each 40 ms", each_40, 20, 40 * MS);
    begin("each 100 ms", each_100, 10, 100 * MS);
    begin("rest", rest, 5, 0);
    return normal();
}
