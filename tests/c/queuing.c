/* A sender that fills a queue, and a receiver that waits for it. The role is the macro RECEIVER. */
#include "partition.h"

static QUEUING_PORT_ID_TYPE port;

#ifdef RECEIVER
static void play(void) {
    char text[16];
    char expected[16];
    MESSAGE_SIZE_TYPE length = 9;
    int number;
    SYSTEM_TIME_TYPE begun = 0, ended = 0;
    for (number = 0; number < 12; number++) {
        EXPECT(NO_ERROR, RECEIVE_QUEUING_MESSAGE(port, INFINITE_TIME_VALUE, (MESSAGE_ADDR_TYPE) text, &length, &code));
        snprintf(expected, sizeof expected, "message %d", number);
        CHECK(length == (MESSAGE_SIZE_TYPE) strlen(expected) && memcmp(text, expected, strlen(expected)) == 0);
    }
    EXPECT(NOT_AVAILABLE, RECEIVE_QUEUING_MESSAGE(port, 0, (MESSAGE_ADDR_TYPE) text, &length, &code));
    CHECK(length == 0);
    EXPECT(NO_ERROR, GET_TIME(&begun, &code));
    EXPECT(TIMED_OUT, RECEIVE_QUEUING_MESSAGE(port, 60 * MS, (MESSAGE_ADDR_TYPE) text, &length, &code));
    EXPECT(NO_ERROR, GET_TIME(&ended, &code));
    CHECK(ended - begun >= 60 * MS && ended - begun <= 80 * MS);
    EXPECT(NO_ERROR, CLEAR_QUEUING_PORT(port, &code));
    say("done");
}
#else
static void play(void) {
    char text[16];
    int number;
    QUEUING_PORT_STATUS_TYPE status;
    for (number = 0; number < 12; number++) {
        snprintf(text, sizeof text, "message %d", number);
        EXPECT(NO_ERROR,
               SEND_QUEUING_MESSAGE(port, (MESSAGE_ADDR_TYPE) text, (MESSAGE_SIZE_TYPE) strlen(text), 500 * MS, &code));
    }
    EXPECT(INVALID_CONFIG, SEND_QUEUING_MESSAGE(port, (MESSAGE_ADDR_TYPE) text, 17, 0, &code));
    EXPECT(INVALID_MODE, CLEAR_QUEUING_PORT(port, &code));
    EXPECT(NO_ERROR, GET_QUEUING_PORT_STATUS(port, &status, &code));
    CHECK(status.MAX_NB_MESSAGE == 4 && status.MAX_MESSAGE_SIZE == 16 && status.PORT_DIRECTION == SOURCE);
    say("done");
}
#endif

int main(void) {
#ifdef RECEIVER
    EXPECT(INVALID_CONFIG, CREATE_QUEUING_PORT("queue", 16, 5, DESTINATION, FIFO, &port, &code));
    EXPECT(NO_ERROR, CREATE_QUEUING_PORT("queue", 16, 4, DESTINATION, FIFO, &port, &code));
#else
    EXPECT(NO_ERROR, CREATE_QUEUING_PORT("queue", 16, 4, SOURCE, PRIORITY, &port, &code));
#endif
    begin("play", play, 10, 0);
    return normal();
}
