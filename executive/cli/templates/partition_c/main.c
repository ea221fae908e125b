/* The partition `{{ partition }}`: say here in a sentence what it is for, and what it must never do.
 *
 * `bateleur new` made it from the schedule file. It runs as it is, and what it sends are zeros. */
#include <string.h>

#include "apex.h"
{% if folders %}
#include "messages.h"
{% endif %}
{% if ports %}

{% for port in ports %}
static {{ port.kind }}_PORT_ID_TYPE {{ port.field }};
{% endfor %}
{% endif %}

/* Called once in each of the partition's periods. Every loop needs a bound; the time is that of GET_TIME, never the system's. */
static void step(void)
{
{% if ports %}
    RETURN_CODE_TYPE code;
{% endif %}
{% for port in ports %}
    static {{ port.type }} {{ port.field }}_message{{ port.length }}; /* a process's stack is small */
{% endfor %}
{% if samples or takes %}
    MESSAGE_SIZE_TYPE length;
{% endif %}
{% if samples %}
    VALIDITY_TYPE validity;
{% endif %}
{% if takes %}
    int taken;
{% endif %}
{% if sends %}
    static unsigned periods;
{% endif %}

{% for port in ports if port.direction == "DESTINATION" and port.kind == "SAMPLING" %}
    /* NO_ACTION before the first message; INVALID once the last is older than the port's `refresh`. */
    READ_SAMPLING_MESSAGE({{ port.field }}, (MESSAGE_ADDR_TYPE) &{{ port.field }}_message, &length, &validity, &code);
    if (code == NO_ERROR && validity == VALID) {
        /* Use it here. */
    }
{% endfor %}
{% for port in ports if port.direction == "DESTINATION" and port.kind == "QUEUING" %}
    for (taken = 0; taken < {{ port.depth }}; taken++) {
        RECEIVE_QUEUING_MESSAGE({{ port.field }}, 0, (MESSAGE_ADDR_TYPE) &{{ port.field }}_message, &length, &code);
        if (code != NO_ERROR && code != INVALID_CONFIG) {
            break;
        }
        /* Use it here. INVALID_CONFIG: others were lost before it. */
    }
{% endfor %}

    /* Compute here. */

{% for port in ports if port.direction == "SOURCE" and port.kind == "SAMPLING" %}
    memset(&{{ port.field }}_message, 0, sizeof {{ port.field }}_message);
    WRITE_SAMPLING_MESSAGE({{ port.field }}, (MESSAGE_ADDR_TYPE) &{{ port.field }}_message, sizeof {{ port.field }}_message, &code);
{% endfor %}
{% if sends %}
    /* In one of 50 periods: a full queue helps nobody. Any code but NO_ERROR means that it was not taken. Never wait. */
    if (periods++ % 50 == 0) {
{% for port in ports if port.direction == "SOURCE" and port.kind == "QUEUING" %}
        memset(&{{ port.field }}_message, 0, sizeof {{ port.field }}_message);
        SEND_QUEUING_MESSAGE({{ port.field }}, (MESSAGE_ADDR_TYPE) &{{ port.field }}_message, sizeof {{ port.field }}_message, 0, &code);
{% endfor %}
    }
{% endif %}
}

/* The partition's only process. */
static void work(void)
{
    RETURN_CODE_TYPE code;

    for (;;) {
        step();
        PERIODIC_WAIT(&code);
    }
}

/* The main process: before the first window, with all the time of `startup_timeout`. Why a service refuses something stands in the
 * partition's log. */
int main(void)
{
    PARTITION_STATUS_TYPE status;
    PROCESS_ATTRIBUTE_TYPE attributes;
    PROCESS_ID_TYPE process;
    RETURN_CODE_TYPE code;

{% for port in ports %}
{% if port.kind == "SAMPLING" %}
    CREATE_SAMPLING_PORT({{ port.name }}, {{ port.size }}, {{ port.direction }}, {{ port.refresh }}, &{{ port.field }}, &code);
{% else %}
    CREATE_QUEUING_PORT({{ port.name }}, {{ port.size }}, {{ port.depth }}, {{ port.direction }}, FIFO, &{{ port.field }}, &code);
{% endif %}
    if (code != NO_ERROR) {
        return 2;
    }
{% endfor %}
    GET_PARTITION_STATUS(&status, &code);
    memset(&attributes, 0, sizeof attributes);
    strcpy(attributes.NAME, "work");
    attributes.ENTRY_POINT = work;
    attributes.STACK_SIZE = 64 * 1024;
    attributes.BASE_PRIORITY = 10;
    attributes.PERIOD = status.PERIOD;
    attributes.TIME_CAPACITY = INFINITE_TIME_VALUE;
    attributes.DEADLINE = SOFT;
    CREATE_PROCESS(&attributes, &process, &code);
    if (code != NO_ERROR) {
        return 3;
    }
    START(process, &code);
    SET_PARTITION_MODE(NORMAL, &code); /* does not return */
    return 4;
}
