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
