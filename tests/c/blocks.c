/* Memory blocks, module schedules and cores, as Part 2 has them. The macro ROLE is `writes`, `reads` or `breaks`. */
#include <stdint.h>
#include <sys/mman.h>

#include "partition.h"

#ifndef ROLE
#define ROLE reads
#endif

static MEMORY_BLOCK_STATUS_TYPE shared, fixed;

/* The first byte counts windows; the others are what the file has. */
static void writes(void) {
    int turn;
    CHECK(shared.MEMORY_BLOCK_MODE == MB_READ_WRITE && memcmp(shared.MEMORY_BLOCK_ADDR, "\0ap", 3) != 0);
    for (turn = 1; turn <= 20; turn++) {
        shared.MEMORY_BLOCK_ADDR[0] = (APEX_BYTE) turn;
        shared.MEMORY_BLOCK_ADDR[shared.MEMORY_BLOCK_SIZE - 1] = (APEX_BYTE) turn;
        EXPECT(NO_ERROR, PERIODIC_WAIT(&code));
    }
    say("done");
    STOP_SELF();
}

static void reads(void) {
    APEX_BYTE last = 0;
    MEMORY_BLOCK_STATUS_TYPE again;
    CHECK(shared.MEMORY_BLOCK_MODE == MB_READ && memcmp(shared.MEMORY_BLOCK_ADDR + 1, "ap", 3) == 0);
    while (last < 20) {
        APEX_BYTE now = shared.MEMORY_BLOCK_ADDR[0];
        CHECK(now == shared.MEMORY_BLOCK_ADDR[shared.MEMORY_BLOCK_SIZE - 1] || last == 0);
        CHECK(now <= 20 ? now >= last && now <= last + 2 : now == 'm' && last == 0);
        if (now <= 20) last = now;
        EXPECT(NO_ERROR, PERIODIC_WAIT(&code));
    }
    EXPECT(NO_ERROR, GET_MEMORY_BLOCK_STATUS("Shared", &again, &code));
    CHECK(again.MEMORY_BLOCK_ADDR == shared.MEMORY_BLOCK_ADDR);
    say("done");
    STOP_SELF();
}

static void breaks(void) {
    void *page = (void *) ((uintptr_t) shared.MEMORY_BLOCK_ADDR & ~(uintptr_t) 4095);
    EXPECT(NO_ERROR, TIMED_WAIT(100 * MS, &code));
    CHECK(mprotect(page, 4096, PROT_READ | PROT_WRITE) != 0);
    say("it is about to write");
    shared.MEMORY_BLOCK_ADDR[0] = 99;
    say("FAILED: it has written");
}

/* What every role checks before NORMAL. */
static void look_around(void) {
    SCHEDULE_STATUS_TYPE schedule;
    SCHEDULE_ID_TYPE only = 0;
    MEMORY_BLOCK_STATUS_TYPE none;
    EXPECT(INVALID_CONFIG, GET_MEMORY_BLOCK_STATUS("nobody's", &none, &code));
    EXPECT(INVALID_PARAM, GET_MEMORY_BLOCK_STATUS("shared", NULL, &code));
    EXPECT(NO_ERROR, GET_MEMORY_BLOCK_STATUS("shared", &shared, &code));
    CHECK(shared.MEMORY_BLOCK_SIZE == 10000);
    EXPECT(NO_ERROR, GET_MEMORY_BLOCK_STATUS("fixed", &fixed, &code));
    CHECK(fixed.MEMORY_BLOCK_MODE == MB_READ && fixed.MEMORY_BLOCK_SIZE == 3);
    CHECK(memcmp(fixed.MEMORY_BLOCK_ADDR, "map", 3) == 0);
    EXPECT(NO_ERROR, GET_MODULE_SCHEDULE_ID("only", &only, &code));
    EXPECT(INVALID_CONFIG, GET_MODULE_SCHEDULE_ID("another", &only, &code));
    EXPECT(NO_ERROR, GET_MODULE_SCHEDULE_STATUS(&schedule, &code));
    CHECK(only != 0 && schedule.CURRENT_SCHEDULE == only && schedule.NEXT_SCHEDULE == only);
    CHECK(schedule.TIME_OF_LAST_SCHEDULE_SWITCH == 0);
    EXPECT(INVALID_CONFIG, SET_MODULE_SCHEDULE(only, &code));
}

int main(void) {
    PROCESS_ID_TYPE id;
    PROCESSOR_CORE_ID_TYPE core = 9;
    look_around();
    id = begin("role", ROLE, 10, ROLE == breaks ? 0 : 20 * MS);
    EXPECT(INVALID_CONFIG, SET_PROCESS_CORE_AFFINITY(id, 7, &code));
    EXPECT(NO_ERROR, GET_PROCESS_CORE_AFFINITY(id, &core, &code));
    CHECK(core == CORE_AFFINITY_NO_PREFERENCE);
    EXPECT(NO_ERROR, SET_PROCESS_CORE_AFFINITY(id, 0, &code));
    EXPECT(NO_ERROR, SET_DEFAULT_PROCESS_CORE_AFFINITY(CORE_AFFINITY_ANY, &code));
    return normal();
}

/* Some of them are not called. */
void (*const all[])(void) = {writes, reads, breaks};
