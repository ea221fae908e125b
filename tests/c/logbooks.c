/* Logbooks, as Part 2 has them: a process that writes in one window and looks in the next. */
#include "partition.h"

static LOGBOOK_ID_TYPE events, single;

static void expect_entry(MESSAGE_RANGE_TYPE entry, const char *message, WRITE_STATUS_TYPE status) {
    char found[8];
    MESSAGE_SIZE_TYPE length = -1;
    WRITE_STATUS_TYPE found_status = ABORTED;
    EXPECT(NO_ERROR, READ_LOGBOOK(events, entry, (MESSAGE_ADDR_TYPE) found, &length, &found_status, &code));
    CHECK(length == (MESSAGE_SIZE_TYPE) strlen(message) && memcmp(found, message, strlen(message)) == 0);
    CHECK(found_status == status);
}

static void expect_counts(MESSAGE_RANGE_TYPE logged, MESSAGE_RANGE_TYPE in_progress) {
    LOGBOOK_STATUS_TYPE status;
    EXPECT(NO_ERROR, GET_LOGBOOK_STATUS(events, &status, &code));
    CHECK(status.MAX_MESSAGE_SIZE == 8 && status.MAX_NB_LOGGED_MESSAGES == 4 && status.MAX_NB_IN_PROGRESS_MESSAGES == 2);
    CHECK(status.NB_LOGGED_MESSAGES == logged && status.NB_IN_PROGRESS_MESSAGES == in_progress);
    CHECK(status.NB_ABORTED_MESSAGES == 0);
}

/* Until the next window: what is on its way is stored then. */
static void next_window(void) {
    EXPECT(NO_ERROR, PERIODIC_WAIT(&code));
}

static void writes(void) {
    char found[8];
    MESSAGE_SIZE_TYPE length;
    WRITE_STATUS_TYPE status;
    EXPECT(NO_ACTION, READ_LOGBOOK(events, 0, (MESSAGE_ADDR_TYPE) found, &length, &status, &code));
    CHECK(length == 0);
    EXPECT(INVALID_PARAM, WRITE_LOGBOOK(events, (MESSAGE_ADDR_TYPE) "123456789", 9, &code));
    EXPECT(INVALID_PARAM, WRITE_LOGBOOK(events, (MESSAGE_ADDR_TYPE) "", 0, &code));
    EXPECT(INVALID_PARAM, WRITE_LOGBOOK(events + 77, (MESSAGE_ADDR_TYPE) "x", 1, &code));
    EXPECT(NO_ERROR, WRITE_LOGBOOK(events, (MESSAGE_ADDR_TYPE) "first", 5, &code));
    EXPECT(NO_ERROR, WRITE_LOGBOOK(events, (MESSAGE_ADDR_TYPE) "second", 6, &code));
    EXPECT(NOT_AVAILABLE, WRITE_LOGBOOK(events, (MESSAGE_ADDR_TYPE) "third", 5, &code));
    EXPECT(NOT_AVAILABLE, CLEAR_LOGBOOK(events, &code));
    expect_entry(0, "second", IN_PROGRESS);
    expect_entry(1, "first", IN_PROGRESS);
    expect_counts(0, 2);
    EXPECT(NO_ERROR, OVERWRITE_LOGBOOK(events, (MESSAGE_ADDR_TYPE) "another", 7, &code));
    expect_entry(0, "another", IN_PROGRESS);
    EXPECT(INVALID_CONFIG, OVERWRITE_LOGBOOK(single, (MESSAGE_ADDR_TYPE) "x", 1, &code));
    next_window();
    expect_entry(0, "another", COMPLETE);
    expect_entry(1, "first", COMPLETE);
    expect_counts(2, 0);
    EXPECT(NO_ERROR, WRITE_LOGBOOK(events, (MESSAGE_ADDR_TYPE) "3", 1, &code));
    next_window();
    EXPECT(NO_ERROR, WRITE_LOGBOOK(events, (MESSAGE_ADDR_TYPE) "4", 1, &code));
    EXPECT(NO_ERROR, WRITE_LOGBOOK(events, (MESSAGE_ADDR_TYPE) "5", 1, &code));
    next_window();
    /* The oldest one has made room. */
    expect_entry(3, "another", COMPLETE);
    expect_entry(0, "5", COMPLETE);
    expect_counts(4, 0);
    EXPECT(INVALID_PARAM, READ_LOGBOOK(events, 4, (MESSAGE_ADDR_TYPE) found, &length, &status, &code));
    EXPECT(INVALID_PARAM, READ_LOGBOOK(events, -1, (MESSAGE_ADDR_TYPE) found, &length, &status, &code));
    EXPECT(NO_ERROR, CLEAR_LOGBOOK(events, &code));
    expect_counts(0, 0);
    say("done");
    while (1) next_window();
}

int main(void) {
    LOGBOOK_ID_TYPE same = 0;
    EXPECT(INVALID_CONFIG, CREATE_LOGBOOK("nobody's", 8, 4, 2, &events, &code));
    EXPECT(INVALID_CONFIG, CREATE_LOGBOOK("events", 8, 5, 2, &events, &code));
    EXPECT(INVALID_PARAM, CREATE_LOGBOOK("events", 8, 4, 2, NULL, &code));
    EXPECT(NO_ERROR, CREATE_LOGBOOK("events", 8, 4, 2, &events, &code));
    EXPECT(NO_ACTION, CREATE_LOGBOOK("Events", 8, 4, 2, &same, &code));
    EXPECT(NO_ERROR, CREATE_LOGBOOK("single", 8, 4, 1, &single, &code));
    EXPECT(NO_ERROR, GET_LOGBOOK_ID("events", &same, &code));
    CHECK(same == events);
    EXPECT(INVALID_CONFIG, GET_LOGBOOK_ID("nobody's", &same, &code));
    begin("writer", writes, 10, 20 * MS);
    return normal();
}
