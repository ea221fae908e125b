/* A producer and a consumer at a buffer of two messages. */
#include "partition.h"

static BUFFER_ID_TYPE buffer;

static void produce(void) {
    int32_t number;
    for (number = 0; number < 200; number++) {
        EXPECT(NO_ERROR, SEND_BUFFER(buffer, (MESSAGE_ADDR_TYPE) &number, sizeof number, INFINITE_TIME_VALUE, &code));
    }
}

static void consume(void) {
    int32_t number, expected;
    MESSAGE_SIZE_TYPE length = 0;
    BUFFER_STATUS_TYPE status;
    for (expected = 0; expected < 200; expected++) {
        EXPECT(NO_ERROR, RECEIVE_BUFFER(buffer, 100 * MS, (MESSAGE_ADDR_TYPE) &number, &length, &code));
        CHECK(length == sizeof number && number == expected);
    }
    EXPECT(TIMED_OUT, RECEIVE_BUFFER(buffer, 20 * MS, (MESSAGE_ADDR_TYPE) &number, &length, &code));
    CHECK(length == 0);
    EXPECT(NO_ERROR, GET_BUFFER_STATUS(buffer, &status, &code));
    CHECK(status.NB_MESSAGE == 0 && status.MAX_NB_MESSAGE == 2 && status.MAX_MESSAGE_SIZE == 4 && status.WAITING_PROCESSES == 0);
    EXPECT(INVALID_PARAM, SEND_BUFFER(buffer, (MESSAGE_ADDR_TYPE) &number, 5, 0, &code));
    say("done");
}

int main(void) {
    BUFFER_ID_TYPE found = 0;
    EXPECT(NO_ERROR, CREATE_BUFFER("numbers", 4, 2, PRIORITY, &buffer, &code));
    EXPECT(NO_ERROR, GET_BUFFER_ID("numbers", &found, &code));
    CHECK(found == buffer);
    begin("produce", produce, 20, 0);
    begin("consume", consume, 10, 0);
    return normal();
}
