/* What the test partitions in C share: they check themselves, and report what fails, and that they came to their end. */
#ifndef PARTITION_H
#define PARTITION_H

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "apex.h"

#define MS ((SYSTEM_TIME_TYPE) 1000000)

/* Reports a line. */
static inline void say(const char *format, ...) {
    char text[MAX_ERROR_MESSAGE_SIZE];
    RETURN_CODE_TYPE code;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    REPORT_APPLICATION_MESSAGE((MESSAGE_ADDR_TYPE) text, (MESSAGE_SIZE_TYPE) strlen(text), &code);
}

#define CHECK(condition) ((condition) ? (void) 0 : say("FAILED %s:%d: %s", __FILE__, __LINE__, #condition))

/* Calls a service, whose last argument is `&code`, and checks what it returns. */
#define EXPECT(expected, call)                                                                                                   \
    do {                                                                                                                         \
        RETURN_CODE_TYPE code = (RETURN_CODE_TYPE) 99;                                                                           \
        call;                                                                                                                    \
        if (code != (expected)) say("FAILED %s:%d: %d", __FILE__, __LINE__, (int) code);                                         \
    } while (0)

/* Creates and starts a process. A period of 0 means none. */
static inline PROCESS_ID_TYPE begin(const char *name, void (*entry)(void), PRIORITY_TYPE priority, SYSTEM_TIME_TYPE period) {
    PROCESS_ATTRIBUTE_TYPE attributes;
    PROCESS_ID_TYPE id = 0;
    memset(&attributes, 0, sizeof attributes);
    attributes.PERIOD = period == 0 ? INFINITE_TIME_VALUE : period;
    attributes.TIME_CAPACITY = INFINITE_TIME_VALUE;
    attributes.ENTRY_POINT = entry;
    attributes.STACK_SIZE = 32 * 1024;
    attributes.BASE_PRIORITY = priority;
    attributes.DEADLINE = SOFT;
    strncpy(attributes.NAME, name, sizeof attributes.NAME - 1);
    EXPECT(NO_ERROR, CREATE_PROCESS(&attributes, &id, &code));
    EXPECT(NO_ERROR, START(id, &code));
    return id;
}

/* The end of the main process. */
static inline int normal(void) {
    RETURN_CODE_TYPE code;
    SET_PARTITION_MODE(NORMAL, &code);
    say("FAILED: SET_PARTITION_MODE returned %d", (int) code);
    return 1;
}

#endif
