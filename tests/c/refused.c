/* Pointers to nothing, numbers that mean nothing, names of the full length. */
#include "partition.h"

static void late(void) {
    SEMAPHORE_ID_TYPE semaphore;
    PROCESS_ID_TYPE id;
    PROCESS_ATTRIBUTE_TYPE attributes;
    ERROR_STATUS_TYPE error;
    memset(&attributes, 0, sizeof attributes);
    attributes.PERIOD = attributes.TIME_CAPACITY = INFINITE_TIME_VALUE;
    attributes.ENTRY_POINT = late;
    attributes.STACK_SIZE = 16384;
    attributes.BASE_PRIORITY = 1;
    strcpy(attributes.NAME, "too late");
    EXPECT(INVALID_MODE, CREATE_PROCESS(&attributes, &id, &code));
    EXPECT(INVALID_MODE, CREATE_SEMAPHORE("too late", 0, 1, FIFO, &semaphore, &code));
    EXPECT(INVALID_MODE, CREATE_ERROR_HANDLER(late, 16384, &code));
    EXPECT(INVALID_CONFIG, GET_ERROR_STATUS(&error, &code));
    say("done");
}

int main(void) {
    /* 32 characters, and no place for a NUL. */
    static const NAME_TYPE longest = {'a', 'b', 'c', 'd', 'e', 'f', 'g', 'h', 'i', 'j', 'k', 'l', 'm', 'n', 'o', 'p',
                                      'q', 'r', 's', 't', 'u', 'v', 'w', 'x', 'y', 'z', '0', '1', '2', '3', '4', '5'};
    EVENT_ID_TYPE event = 0, found = 0;
    SEMAPHORE_ID_TYPE semaphore = 0;
    PROCESS_ID_TYPE process = 0;
    PROCESS_ATTRIBUTE_TYPE attributes;
    BLACKBOARD_ID_TYPE board = 0;
    SAMPLING_PORT_ID_TYPE port = 0;
    MESSAGE_SIZE_TYPE length = 7;
    EXPECT(NO_ERROR, CREATE_EVENT(longest, &event, &code));
    EXPECT(NO_ACTION, CREATE_EVENT(longest, &found, &code));
    EXPECT(NO_ERROR, GET_EVENT_ID(longest, &found, &code));
    CHECK(found == event);
    EXPECT(INVALID_PARAM, CREATE_EVENT(NULL, &event, &code));
    EXPECT(INVALID_PARAM, CREATE_EVENT("no place", NULL, &code));
    EXPECT(INVALID_CONFIG, GET_EVENT_ID("no place", &found, &code));
    SET_EVENT(event, NULL);
    EXPECT(INVALID_PARAM, SET_EVENT(event + 1, &code));
    EXPECT(INVALID_PARAM, GET_TIME(NULL, &code));
    EXPECT(INVALID_PARAM, CREATE_SEMAPHORE("semaphore", 2, 1, FIFO, &semaphore, &code));
    EXPECT(INVALID_PARAM, CREATE_SEMAPHORE("semaphore", 0, 1, (QUEUING_DISCIPLINE_TYPE) 2, &semaphore, &code));
    EXPECT(INVALID_PARAM, SET_PARTITION_MODE((OPERATING_MODE_TYPE) 4, &code));
    EXPECT(INVALID_PARAM, CREATE_PROCESS(NULL, &process, &code));
    memset(&attributes, 0, sizeof attributes);
    EXPECT(INVALID_PARAM, CREATE_PROCESS(&attributes, &process, &code));
    EXPECT(INVALID_PARAM, CREATE_ERROR_HANDLER(NULL, 16384, &code));
    EXPECT(NO_ERROR, CREATE_BLACKBOARD("board", 8, &board, &code));
    EXPECT(INVALID_PARAM, DISPLAY_BLACKBOARD(board, (MESSAGE_ADDR_TYPE) &length, -1, &code));
    EXPECT(INVALID_PARAM, DISPLAY_BLACKBOARD(board, NULL, 4, &code));
    EXPECT(INVALID_PARAM, READ_BLACKBOARD(board, 0, NULL, &length, &code));
    EXPECT(NOT_AVAILABLE, READ_BLACKBOARD(board, 0, (MESSAGE_ADDR_TYPE) &found, &length, &code));
    CHECK(length == 0);
    EXPECT(INVALID_PARAM, REPORT_APPLICATION_MESSAGE((MESSAGE_ADDR_TYPE) &length, 129, &code));
    EXPECT(INVALID_PARAM, RAISE_APPLICATION_ERROR(NUMERIC_ERROR, (MESSAGE_ADDR_TYPE) &length, 1, &code));
    EXPECT(INVALID_CONFIG, CREATE_SAMPLING_PORT("nowhere", 8, SOURCE, 1, &port, &code));
    begin("late", late, 1, 0);
    return normal();
}
