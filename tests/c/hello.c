/* What a partition and a process are told of themselves. */
#include "partition.h"

static void greet(void) {
    PROCESS_ID_TYPE id = 0;
    PROCESS_INDEX_TYPE index = 9;
    PROCESSOR_CORE_ID_TYPE core = 9;
    PROCESS_STATUS_TYPE status;
    PARTITION_STATUS_TYPE partition;
    EXPECT(NO_ERROR, GET_MY_ID(&id, &code));
    EXPECT(NO_ERROR, GET_MY_INDEX(&index, &code));
    EXPECT(NO_ERROR, GET_MY_PROCESSOR_CORE_ID(&core, &code));
    CHECK(index == 0 && core == 0);
    EXPECT(NO_ERROR, GET_PROCESS_STATUS(id, &status, &code));
    CHECK(status.PROCESS_STATE == RUNNING && status.CURRENT_PRIORITY == 7);
    CHECK(status.ATTRIBUTES.ENTRY_POINT == greet && strcmp(status.ATTRIBUTES.NAME, "greet") == 0);
    EXPECT(NO_ERROR, GET_PARTITION_STATUS(&partition, &code));
    CHECK(partition.OPERATING_MODE == NORMAL && partition.PERIOD == 20 * MS);
    EXPECT(NO_ACTION, SET_PARTITION_MODE(NORMAL, &code));
    printf("printed without an end of the file\n");
    say("done");
}

int main(void) {
    static const APEX_BYTE message[] = {0x03, 0x0C, 0x31, 0x30, 1};
    PARTITION_STATUS_TYPE partition;
    PROCESS_ID_TYPE id = 0, found = 0;
    EXPECT(NO_ERROR, GET_PARTITION_STATUS(&partition, &code));
    CHECK(partition.OPERATING_MODE == COLD_START && partition.START_CONDITION == NORMAL_START);
    CHECK(bateleur_functional_status(message, 5, VALID, 0) == NORMAL_OPERATION);
    CHECK(bateleur_functional_status(message, 5, VALID, 1) == FUNCTIONAL_TEST);
    CHECK(bateleur_functional_status(message, 5, VALID, 2) == NO_DATA);
    CHECK(bateleur_functional_status(message, 5, VALID, 3) == NO_COMPUTED_DATA);
    CHECK(bateleur_functional_status(message, 5, INVALID, 0) == NO_DATA && bateleur_functional_status(message, 3, VALID, 0) == NO_DATA);
    EXPECT(INVALID_MODE, GET_MY_ID(&id, &code));
    EXPECT(INVALID_MODE, SET_PARTITION_MODE(WARM_START, &code));
    EXPECT(INVALID_MODE, TIMED_WAIT(1, &code));
    id = begin("greet", greet, 7, 0);
    EXPECT(NO_ERROR, GET_PROCESS_ID("GREET", &found, &code));
    CHECK(found == id);
    EXPECT(INVALID_CONFIG, GET_PROCESS_ID("nobody", &found, &code));
    return normal();
}
