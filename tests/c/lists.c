/* A sender to two ports, and a receiver that waits at both by a list. The role is the macro RECEIVER. */
#include "partition.h"

static QUEUING_PORT_ID_TYPE ports[2];
static const char *const names[2] = {"one", "two"};

#ifdef RECEIVER
static QUEUING_PORT_LIST_ID_TYPE list;

static void play(void) {
    char text[16];
    char expected[16];
    MESSAGE_SIZE_TYPE length = 9;
    QUEUING_PORT_ID_TYPE from = 0;
    PORT_ACTION_TYPE action = INACTIVE;
    int count, next[2] = {0, 0};
    EXPECT(NO_ERROR, WAIT_FOR_MESSAGE_FROM_QUEUING_PORT_LIST(list, INFINITE_TIME_VALUE, RESET, &from, &code));
    CHECK(from == ports[0]);
    EXPECT(INVALID_PARAM, RECEIVE_MESSAGE_FROM_QUEUING_PORT_LIST(
        list, 0, (MESSAGE_ADDR_TYPE) text, 4, RESET, &from, &length, &code));
    CHECK(length == 0);
    for (count = 0; count < 12; count++) {
        int of;
        EXPECT(NO_ERROR, RECEIVE_MESSAGE_FROM_QUEUING_PORT_LIST(
            list, INFINITE_TIME_VALUE, (MESSAGE_ADDR_TYPE) text, 16, CONTINUE, &from, &length, &code));
        CHECK(from == ports[0] || from == ports[1]);
        of = from == ports[1];
        snprintf(expected, sizeof expected, "%s %d", names[of], next[of]++);
        CHECK(length == (MESSAGE_SIZE_TYPE) strlen(expected) && memcmp(text, expected, strlen(expected)) == 0);
    }
    CHECK(next[0] == 6 && next[1] == 6);
    EXPECT(NOT_AVAILABLE, RECEIVE_MESSAGE_FROM_QUEUING_PORT_LIST(
        list, 0, (MESSAGE_ADDR_TYPE) text, 16, RESET, &from, &length, &code));
    EXPECT(TIMED_OUT, WAIT_FOR_MESSAGE_FROM_QUEUING_PORT_LIST(list, 60 * MS, RESET, &from, &code));
    CHECK(from == 0);
    EXPECT(NO_ERROR, GET_QUEUING_PORT_ACTION_STATUS(list, ports[1], &action, &code));
    CHECK(action == ACTIVE);
    EXPECT(NO_ACTION, SET_PORT_ACTION_IN_QUEUING_PORT_LIST(list, ports[1], ACTIVE, &code));
    EXPECT(NO_ERROR, SET_PORT_ACTION_IN_QUEUING_PORT_LIST(list, ports[1], INACTIVE, &code));
    say("done");
}
#else
static void play(void) {
    char text[16];
    int number, of;
    for (number = 0; number < 6; number++) {
        for (of = 0; of < 2; of++) {
            snprintf(text, sizeof text, "%s %d", names[of], number);
            EXPECT(NO_ERROR, SEND_QUEUING_MESSAGE(
                ports[of], (MESSAGE_ADDR_TYPE) text, (MESSAGE_SIZE_TYPE) strlen(text), 500 * MS, &code));
        }
    }
    say("done");
}
#endif

int main(void) {
    int of;
#ifdef RECEIVER
    EXPECT(NO_ERROR, CREATE_QUEUING_PORT_LIST("both", 2, &list, &code));
    EXPECT(NO_ACTION, CREATE_QUEUING_PORT_LIST("Both", 2, &list, &code));
#endif
    for (of = 0; of < 2; of++) {
#ifdef RECEIVER
        EXPECT(NO_ERROR, CREATE_QUEUING_PORT(names[of], 16, 4, DESTINATION, FIFO, &ports[of], &code));
        EXPECT(NO_ERROR, ADD_PORT_TO_QUEUING_PORT_LIST(list, ports[of], ACTIVE, &code));
#else
        EXPECT(NO_ERROR, CREATE_QUEUING_PORT(names[of], 16, 4, SOURCE, FIFO, &ports[of], &code));
#endif
    }
    begin("play", play, 10, 0);
    return normal();
}
