/* A ping that a pong answers, over two sampling ports. The role is the macro PONG. */
#include "partition.h"
#include "messages.h"

static SAMPLING_PORT_ID_TYPE out, in;

static void play(void) {
    bateleur_Number mine = {0}, heard = {0};
    MESSAGE_SIZE_TYPE length;
    VALIDITY_TYPE validity;
    RETURN_CODE_TYPE read;
#ifndef PONG
    SAMPLING_PORT_STATUS_TYPE status;
    SAMPLING_PORT_CURRENT_STATUS_TYPE current;
    SYSTEM_TIME_TYPE stamp;
    UPDATED_TYPE updated;
    EXPECT(NO_ACTION, READ_UPDATED_SAMPLING_MESSAGE(in, (MESSAGE_ADDR_TYPE) &heard, &length, &updated, &code));
    CHECK(updated == EMPTY_PORT && length == 0);
    EXPECT(NO_ACTION, READ_SAMPLING_MESSAGE_CONDITIONAL(in, -1, (MESSAGE_ADDR_TYPE) &heard, &length, &stamp, &code));
    CHECK(stamp == 0 && length == 0);
#endif
    for (;;) {
        READ_SAMPLING_MESSAGE(in, (MESSAGE_ADDR_TYPE) &heard, &length, &validity, &read);
        CHECK(read == NO_ERROR ? length == sizeof heard && validity == VALID : read == NO_ACTION && length == 0);
#ifdef PONG
        mine.number = read == NO_ERROR ? heard.number : 0;
#else
        CHECK(read == NO_ACTION || heard.number == mine.number);
        mine.number += read == NO_ERROR;
        if (mine.number == 20) {
            EXPECT(INVALID_CONFIG, WRITE_SAMPLING_MESSAGE(out, (MESSAGE_ADDR_TYPE) &mine, 5, &code));
            EXPECT(INVALID_PARAM, WRITE_SAMPLING_MESSAGE(out, (MESSAGE_ADDR_TYPE) &mine, 0, &code));
            EXPECT(INVALID_MODE, WRITE_SAMPLING_MESSAGE(in, (MESSAGE_ADDR_TYPE) &mine, 4, &code));
            EXPECT(NO_ERROR, GET_SAMPLING_PORT_STATUS(in, &status, &code));
            EXPECT(NO_ERROR, GET_SAMPLING_PORT_CURRENT_STATUS(in, &current, &code));
            CHECK(current.UPDATED == CONSUMED_MESSAGE && current.MESSAGE_AGE == FRESH && current.TIME_STAMP > 0);
            CHECK(current.REFRESH_PERIOD == 100 * MS && current.MAX_MESSAGE_SIZE == 4 && current.PORT_DIRECTION == DESTINATION);
            EXPECT(NO_ACTION, READ_UPDATED_SAMPLING_MESSAGE(in, (MESSAGE_ADDR_TYPE) &heard, &length, &updated, &code));
            CHECK(updated == CONSUMED_MESSAGE && length == 0);
            EXPECT(INVALID_MODE, READ_UPDATED_SAMPLING_MESSAGE(out, (MESSAGE_ADDR_TYPE) &heard, &length, &updated, &code));
            EXPECT(NO_ACTION, READ_SAMPLING_MESSAGE_CONDITIONAL(
                in, current.TIME_STAMP, (MESSAGE_ADDR_TYPE) &heard, &length, &stamp, &code));
            CHECK(stamp == current.TIME_STAMP && length == 0);
            EXPECT(NO_ERROR, READ_SAMPLING_MESSAGE_CONDITIONAL(
                in, current.TIME_STAMP - 1, (MESSAGE_ADDR_TYPE) &heard, &length, &stamp, &code));
            CHECK(stamp == current.TIME_STAMP && length == sizeof heard && heard.number == mine.number - 1);
            CHECK(status.REFRESH_PERIOD == 100 * MS && status.LAST_MSG_VALIDITY == VALID && status.MAX_MESSAGE_SIZE == 4);
        }
#endif
        EXPECT(NO_ERROR, WRITE_SAMPLING_MESSAGE(out, (MESSAGE_ADDR_TYPE) &mine, sizeof mine, &code));
        if (mine.number == 20) {
            say("done");
            STOP_SELF();
        }
        EXPECT(NO_ERROR, PERIODIC_WAIT(&code));
    }
}

int main(void) {
    EXPECT(INVALID_CONFIG, CREATE_SAMPLING_PORT("OUT", 5, SOURCE, 100 * MS, &out, &code));
    EXPECT(NO_ERROR, CREATE_SAMPLING_PORT("OUT", 4, SOURCE, 100 * MS, &out, &code));
    EXPECT(NO_ERROR, CREATE_SAMPLING_PORT("in", 4, DESTINATION, 100 * MS, &in, &code));
    EXPECT(NO_ACTION, CREATE_SAMPLING_PORT("in", 4, DESTINATION, 100 * MS, &in, &code));
    begin("play", play, 10, 20 * MS);
    return normal();
}
