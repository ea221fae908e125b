/* A partition with one process, which says every 100 ms what time it is. */
#include <stdio.h>
#include <string.h>

#include <apex.h>

static void greet(void) {
    for (;;) {
        SYSTEM_TIME_TYPE now;
        RETURN_CODE_TYPE code;
        char text[MAX_ERROR_MESSAGE_SIZE];
        GET_TIME(&now, &code);
        snprintf(text, sizeof text, "good day at %lld ns", (long long) now);
        REPORT_APPLICATION_MESSAGE((MESSAGE_ADDR_TYPE) text, (MESSAGE_SIZE_TYPE) strlen(text), &code);
        PERIODIC_WAIT(&code);
    }
}

int main(void) {
    PROCESS_ATTRIBUTE_TYPE attributes;
    PROCESS_ID_TYPE id;
    RETURN_CODE_TYPE code;

    memset(&attributes, 0, sizeof attributes);
    strcpy(attributes.NAME, "greet");
    attributes.ENTRY_POINT = greet;
    attributes.STACK_SIZE = 16 * 1024;
    attributes.BASE_PRIORITY = 10;
    attributes.PERIOD = 100000000;
    attributes.TIME_CAPACITY = INFINITE_TIME_VALUE;
    attributes.DEADLINE = SOFT;

    CREATE_PROCESS(&attributes, &id, &code);
    if (code != NO_ERROR) return 1;
    START(id, &code);
    SET_PARTITION_MODE(NORMAL, &code);
    return 1; /* not reached */
}
