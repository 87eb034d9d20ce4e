/* A computer in place of a board: ./board LINK PULSES [PORT]. The line is a pseudo terminal, with the symbolic link LINK. Clock
   [us] and commands are written to the file PULSES, a row a tick. The servos cannot tell their angles; with a PORT they are
   those of a robot simulated there, `python -P -m stewart_drake.machines.simulated`, and tell them. */
#define _GNU_SOURCE
#include "hexapod.h"
#include "robot_side.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

static int line, robot = -1;
static FILE *pulses;
static sd_packet packet; /* to the simulated robot */

void board_begin(uint32_t baud, uint32_t period_us)
{
    (void)baud, (void)period_us;
}
uint32_t board_micros(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)(1000000u * (uint64_t)now.tv_sec + (uint64_t)now.tv_nsec / 1000u);
}
int board_getc(void)
{
    uint8_t byte;
    return read(line, &byte, 1) == 1 ? byte : -1;
}
void board_write(const uint8_t *bytes, unsigned size)
{
    if (write(line, bytes, size) < 0) { /* nobody reads: dropped */
    }
}
void board_servos(const uint16_t commands[6])
{
    uint8_t bytes[SD_SIZE];
    fprintf(pulses, "%lu", (unsigned long)board_micros());
    for (int k = 0; k < 6; k++) {
        fprintf(pulses, ",%u", commands[k]);
        packet.values[k] = (float)hexapod_angle(k, commands[k]);
    }
    fputc('\n', pulses);
    packet.flags = SD_ACTIVE, packet.number++;
    sd_encode(&packet, bytes);
    if (robot >= 0 && send(robot, bytes, SD_SIZE, 0) < 0) { /* not there: lost */
    }
}
int board_positions(uint16_t commands[6])
{
    static uint16_t newest[6];
    static int age = 1000; /* calls since the newest reading */
    uint8_t bytes[SD_SIZE];
    sd_packet reading;
    if (robot >= 0 && packet.number == 0) { /* asks, and moves nothing */
        sd_encode(&packet, bytes);
        usleep(send(robot, bytes, SD_SIZE, 0) < 0 ? 100000 : 50000);
    }
    for (age++; robot >= 0 && recv(robot, bytes, SD_SIZE, MSG_DONTWAIT) == SD_SIZE;) {
        for (int k = 0; k < 6 && sd_decode(bytes, SD_SIZE, &reading); k++) {
            newest[k] = hexapod_command(k, reading.values[k]);
            age = 0;
        }
    }
    for (int k = 0; k < 6; k++) {
        commands[k] = newest[k];
    }
    return robot < 0 ? -1 : age < 10;
}

int main(int count, char **arguments)
{
    struct sockaddr_in at = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    struct termios raw;
    if (count < 3 || (pulses = fopen(arguments[2], "w")) == NULL) {
        return fprintf(stderr, "usage: %s LINK PULSES [PORT]\n", arguments[0]), 2;
    }
    setvbuf(pulses, NULL, _IOLBF, 0);
    line = posix_openpt(O_RDWR | O_NOCTTY);
    const int end = line < 0 || grantpt(line) || unlockpt(line) ? -1 : open(ptsname(line), O_RDWR | O_NOCTTY);
    unlink(arguments[1]);
    if (end < 0 || tcgetattr(end, &raw) || symlink(ptsname(line), arguments[1])) {
        return perror(arguments[1]), 1;
    }
    cfmakeraw(&raw);
    tcsetattr(end, TCSANOW, &raw);
    fcntl(line, F_SETFL, O_NONBLOCK);
    if (count > 3) {
        at.sin_port = htons((uint16_t)atoi(arguments[3]));
        robot = socket(AF_INET, SOCK_DGRAM, 0);
        if (connect(robot, (struct sockaddr *)&at, sizeof at)) {
            return perror(arguments[3]), 1;
        }
    }
    hexapod_begin();
    printf("drive it as serial:%s\n", arguments[1]);
    for (fflush(stdout);; usleep(500)) {
        hexapod_poll();
    }
}
