/* A mutex whose owner runs at its priority, is owned by the main process first, and handed on. Identifiers of 64 bits. */
#define APEX_IDENTIFIER_BITS 64
#include "partition.h"

static MUTEX_ID_TYPE mutex;
static PROCESS_ID_TYPE owner;
static int order;

static void own(void) {
    PROCESS_STATUS_TYPE status;
    MUTEX_STATUS_TYPE lock;
    MUTEX_ID_TYPE owned = 0;
    EXPECT(NO_ERROR, ACQUIRE_MUTEX(mutex, INFINITE_TIME_VALUE, &code));
    EXPECT(NO_ERROR, ACQUIRE_MUTEX(mutex, 0, &code));
    EXPECT(NO_ERROR, GET_PROCESS_STATUS(owner, &status, &code));
    CHECK(status.CURRENT_PRIORITY == 60);
    EXPECT(NO_ERROR, GET_MUTEX_STATUS(mutex, &lock, &code));
    CHECK(lock.MUTEX_OWNER == owner && lock.MUTEX_STATE == OWNED && lock.LOCK_COUNT == 2);
    EXPECT(NO_ERROR, GET_PROCESS_MUTEX_STATE(owner, &owned, &code));
    CHECK(owned == mutex);
    EXPECT(INVALID_MODE, TIMED_WAIT(MS, &code));
    CHECK(order == 0);
    EXPECT(NO_ERROR, RELEASE_MUTEX(mutex, &code));
    EXPECT(NO_ERROR, RELEASE_MUTEX(mutex, &code));
    EXPECT(INVALID_MODE, RELEASE_MUTEX(mutex, &code));
    CHECK(order == 1);
    EXPECT(NO_ERROR, GET_PROCESS_MUTEX_STATE(owner, &owned, &code));
    CHECK(owned == NO_MUTEX_OWNED);
    EXPECT(INVALID_PARAM, RELEASE_MUTEX(mutex + ((MUTEX_ID_TYPE) 1 << 32), &code));
    EXPECT(INVALID_PARAM, ACQUIRE_MUTEX(PREEMPTION_LOCK_MUTEX, 0, &code));
    say("done");
}

static void urgent(void) {
    EXPECT(NO_ERROR, TIMED_WAIT(2 * 1000, &code));
    EXPECT(NO_ERROR, ACQUIRE_MUTEX(mutex, INFINITE_TIME_VALUE, &code));
    order = 1;
    EXPECT(NO_ERROR, RELEASE_MUTEX(mutex, &code));
}

int main(void) {
    MUTEX_STATUS_TYPE lock;
    EXPECT(INVALID_PARAM, CREATE_MUTEX("mutex", 240, FIFO, &mutex, &code));
    EXPECT(NO_ERROR, CREATE_MUTEX("mutex", 60, FIFO, &mutex, &code));
    EXPECT(NO_ERROR, ACQUIRE_MUTEX(mutex, 0, &code));
    EXPECT(NO_ERROR, GET_MUTEX_STATUS(mutex, &lock, &code));
    CHECK(lock.MUTEX_OWNER == MAIN_PROCESS_ID);
    EXPECT(NO_ERROR, RELEASE_MUTEX(mutex, &code));
    begin("urgent", urgent, 50, 0);
    owner = begin("owner", own, 10, 0);
    return normal();
}
