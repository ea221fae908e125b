/* Two readers of one blackboard, before and after something is displayed. */
#include "partition.h"

static BLACKBOARD_ID_TYPE board;
static int woken;

static void reader(void) {
    char text[16] = "";
    MESSAGE_SIZE_TYPE length = 0;
    EXPECT(NO_ERROR, READ_BLACKBOARD(board, INFINITE_TIME_VALUE, (MESSAGE_ADDR_TYPE) text, &length, &code));
    CHECK(length == 6 && strcmp(text, "first") == 0);
    woken++;
}

static void writer(void) {
    char text[16] = "";
    MESSAGE_SIZE_TYPE length = 0;
    BLACKBOARD_STATUS_TYPE status;
    EXPECT(NO_ERROR, GET_BLACKBOARD_STATUS(board, &status, &code));
    CHECK(status.EMPTY_INDICATOR == EMPTY && status.WAITING_PROCESSES == 2);
    EXPECT(NO_ERROR, DISPLAY_BLACKBOARD(board, (MESSAGE_ADDR_TYPE) "first", 6, &code));
    CHECK(woken == 2);
    EXPECT(NO_ERROR, DISPLAY_BLACKBOARD(board, (MESSAGE_ADDR_TYPE) "second", 7, &code));
    EXPECT(NO_ERROR, READ_BLACKBOARD(board, 0, (MESSAGE_ADDR_TYPE) text, &length, &code));
    CHECK(length == 7 && strcmp(text, "second") == 0);
    EXPECT(NO_ERROR, CLEAR_BLACKBOARD(board, &code));
    EXPECT(TIMED_OUT, READ_BLACKBOARD(board, 20 * MS, (MESSAGE_ADDR_TYPE) text, &length, &code));
    CHECK(length == 0);
    say("done");
}

int main(void) {
    EXPECT(NO_ERROR, CREATE_BLACKBOARD("board", 16, &board, &code));
    begin("reader one", reader, 30, 0);
    begin("reader two", reader, 20, 0);
    begin("writer", writer, 10, 0);
    return normal();
}
