/* Name services, as Part 2 has them: what the plan knows is answered at once, anything else never. */
#include "partition.h"

static NAME_SERVICE_ID_TYPE stations;

static void asks(void) {
    SAP_ADDRESS_TYPE address = {0, 0};
    SYSTEM_TIME_TYPE before = 0, after = 0;
    MESSAGE_SIZE_TYPE length = -1;
    char name[8];
    EXPECT(NO_ERROR, GET_ADDRESS(stations, (MESSAGE_ADDR_TYPE) "ground", 6, INFINITE_TIME_VALUE, &address, &code));
    CHECK(address.IP_ADDRESS == 0x0A4D0001u && address.UDP_PORT == 14550u);
    EXPECT(NO_ERROR, GET_NAME(stations, address, 0, (MESSAGE_ADDR_TYPE) name, sizeof name, &length, &code));
    CHECK(length == 6 && memcmp(name, "ground", 6) == 0);
    EXPECT(INVALID_CONFIG, GET_NAME(stations, address, 0, (MESSAGE_ADDR_TYPE) name, 5, &length, &code));
    CHECK(length == 0);
    EXPECT(INVALID_PARAM, GET_NAME(stations, address, 0, (MESSAGE_ADDR_TYPE) name, 0, &length, &code));
    address.UDP_PORT = 65536u + 14550u;
    EXPECT(NOT_AVAILABLE, GET_NAME(stations, address, 0, (MESSAGE_ADDR_TYPE) name, sizeof name, &length, &code));
    EXPECT(NOT_AVAILABLE, GET_ADDRESS(stations, (MESSAGE_ADDR_TYPE) "nobody", 6, 0, &address, &code));
    EXPECT(INVALID_PARAM, GET_ADDRESS(stations, (MESSAGE_ADDR_TYPE) "", 0, 0, &address, &code));
    EXPECT(INVALID_PARAM, GET_ADDRESS(stations + 77, (MESSAGE_ADDR_TYPE) "ground", 6, 0, &address, &code));
    EXPECT(NO_ERROR, GET_TIME(&before, &code));
    EXPECT(TIMED_OUT, GET_ADDRESS(stations, (MESSAGE_ADDR_TYPE) "nobody", 6, 50 * MS, &address, &code));
    EXPECT(NO_ERROR, GET_TIME(&after, &code));
    CHECK(after - before >= 50 * MS);
    say("done");
    EXPECT(NO_ACTION, CREATE_NAME_SERVICE("stations", FIFO, &stations, &code));
    STOP_SELF();
}

int main(void) {
    NAME_SERVICE_ID_TYPE other;
    EXPECT(INVALID_CONFIG, CREATE_NAME_SERVICE("others", FIFO, &other, &code));
    EXPECT(NO_ERROR, CREATE_NAME_SERVICE("stations", FIFO, &stations, &code));
    EXPECT(NO_ACTION, CREATE_NAME_SERVICE("stations", FIFO, &other, &code));
    begin("asks", asks, 10, 0);
    return normal();
}
