/* An error handler that starts faulty processes again, each of which has another fault in its first life. */
#include <stdlib.h>

#include "partition.h"

static PROCESS_ID_TYPE divides, writes, overflows, raises, late;
static int lives[6], errors, before_normal;

static volatile int zero = 0, one = 1;
static volatile int *volatile nowhere = (volatile int *) 16;

static void divide(void) {
#if defined(__x86_64__)
    if (lives[0]++ == 0) zero = one / zero;
#else
    if (lives[0]++ == 0) __builtin_trap();
#endif
}

static void write_nowhere(void) {
    if (lives[1]++ == 0) *nowhere = 1;
}

static int deep(int depth) {
    volatile char frame[1024];
    frame[0] = (char) depth;
    return depth == 0 ? 0 : deep(depth + 1) + frame[0];
}

static void overflow(void) {
    if (lives[2]++ == 0) say("%d", deep(1));
}

static void raise_it(void) {
    EXPECT(NO_ERROR, RAISE_APPLICATION_ERROR(APPLICATION_ERROR, (MESSAGE_ADDR_TYPE) "as it was told", 14, &code));
    lives[3]++;
}

static void be_late(void) {
    lives[4]++;
    EXPECT(NO_ERROR, TIMED_WAIT(30 * MS, &code));
    lives[4]++;
}

static void handle(void) {
    ERROR_STATUS_TYPE error;
    RETURN_CODE_TYPE got;
    for (;;) {
        GET_ERROR_STATUS(&error, &got);
        if (got == NO_ACTION) STOP_SELF();
        if (error.FAILED_PROCESS_ID == MAIN_PROCESS_ID) {
            CHECK(error.ERROR_CODE == APPLICATION_ERROR && error.LENGTH == 5);
            EXPECT(INVALID_MODE, SET_PARTITION_MODE(NORMAL, &code));
            before_normal++;
            continue;
        }
        errors++;
        if (error.FAILED_PROCESS_ID == divides) {
#if defined(__x86_64__)
            CHECK(error.ERROR_CODE == NUMERIC_ERROR);
#else
            CHECK(error.ERROR_CODE == ILLEGAL_REQUEST);
#endif
        }
        if (error.FAILED_PROCESS_ID == writes) CHECK(error.ERROR_CODE == MEMORY_VIOLATION && (uintptr_t) error.FAILED_ADDRESS == 16);
        if (error.FAILED_PROCESS_ID == overflows) CHECK(error.ERROR_CODE == STACK_OVERFLOW);
        if (error.FAILED_PROCESS_ID == late) CHECK(error.ERROR_CODE == DEADLINE_MISSED);
        if (error.FAILED_PROCESS_ID == raises) {
            CHECK(error.ERROR_CODE == APPLICATION_ERROR && error.LENGTH == 14);
            CHECK(memcmp(error.MESSAGE, "as it was told", 14) == 0);
            continue;
        }
        EXPECT(NO_ERROR, STOP(error.FAILED_PROCESS_ID, &code));
        if (error.FAILED_PROCESS_ID != late) EXPECT(NO_ERROR, START(error.FAILED_PROCESS_ID, &code));
    }
}

static void watch(void) {
    EXPECT(NO_ERROR, TIMED_WAIT(1500 * MS, &code));
    CHECK(lives[0] == 2 && lives[1] == 2 && lives[2] == 2 && lives[3] == 1);
    /* Its deadline may have passed before it had its first turn. */
    CHECK(lives[4] <= 1);
    CHECK(errors == 5);
    if (errors != 5) say("FAILED %d errors", errors);
    say("done");
}

int main(void) {
    PROCESS_ATTRIBUTE_TYPE attributes;
    EXPECT(NO_ACTION, ENABLE_ERROR_HANDLER(&code));
    EXPECT(NO_ERROR, CREATE_ERROR_HANDLER(handle, 32 * 1024, &code));
    EXPECT(NO_ACTION, CREATE_ERROR_HANDLER(handle, 32 * 1024, &code));
    EXPECT(NO_ERROR, ENABLE_ERROR_HANDLER(&code));
    EXPECT(NO_ERROR, RAISE_APPLICATION_ERROR(APPLICATION_ERROR, (MESSAGE_ADDR_TYPE) "early", 5, &code));
    CHECK(before_normal == 1);
    divides = begin("divides", divide, 50, 0);
    writes = begin("writes", write_nowhere, 40, 0);
    overflows = begin("overflows", overflow, 30, 0);
    raises = begin("raises", raise_it, 20, 0);
    memset(&attributes, 0, sizeof attributes);
    attributes.PERIOD = INFINITE_TIME_VALUE;
    attributes.TIME_CAPACITY = 5 * MS;
    attributes.ENTRY_POINT = be_late;
    attributes.STACK_SIZE = 16384;
    attributes.BASE_PRIORITY = 15;
    strcpy(attributes.NAME, "late");
    EXPECT(NO_ERROR, CREATE_PROCESS(&attributes, &late, &code));
    EXPECT(NO_ERROR, START(late, &code));
    begin("watch", watch, 60, 0);
    return normal();
}
