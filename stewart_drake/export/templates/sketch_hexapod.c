/* Six hobby servos behind the packets of docs/wire.md, for @SCENARIO@, by stewart-drake @VERSION@. C99; nothing is allocated.

   A packet has six angles of the cranks, or a pose where servos.h has SERVOS_POSES: then pose.c computes the angles, with the
   torques of the weight. Every SERVOS_PERIOD_US the servos get a command, and the computer a reading.

   Start: cranks are where their servos tell. Servos that cannot tell are taken to be at home, and sent there.
   Jumps: after a pause the way to the first command is a straight line of the cranks at SERVOS_SLOW, then faster, until it is
   caught up with. Afterwards no crank is commanded faster than SERVOS_FASTEST.
   Silence: 0.1 s after the last active packet the robot holds. SERVOS_REST_US after the last packet of any kind it moves home
   at SERVOS_SLOW, and holds there. The servos keep their pulses.
   Limits: packets with an angle outside of them are not accepted, and no command is ever outside of them. */
#include "hexapod.h"
#include "robot_side.h"
#include "servos.h"

#include <math.h>
#include <string.h>

static sd_side side;
static uint8_t frame[SD_FRAME]; /* from the computer, so far */
static unsigned used;
static uint64_t now_us, due_us;
static uint32_t clock_us;
static double angles[6], goal[6]; /* [rad] commanded now, and to be commanded in the end */
static double speed;              /* [rad/s] of the fastest crank */

uint16_t hexapod_command(int leg, double angle)
{
    const double command = floor(SERVOS_MIDDLE + servos_per_rad[leg] * (angle - servos_zero[leg]) + 0.5);
    if (!(command > servos_least[leg])) { /* what is not a number too */
        return servos_least[leg];
    }
    return command < servos_most[leg] ? (uint16_t)command : servos_most[leg];
}

double hexapod_angle(int leg, uint16_t command)
{
    return servos_zero[leg] + (command - SERVOS_MIDDLE) / servos_per_rad[leg];
}

#if SERVOS_POSES
#include "pose.h"

static struct pose_controller controller;

/* Angles at the pose of a packet, as if at rest there; without a solution, or beyond the limits, the robot stays. */
static void goal_from_pose(void)
{
    double reference[POSE_REFERENCE] = {0.0}, reading[POSE_READING], command[6];
    for (int k = 0; k < POSE_REFERENCE; k++) {
        reference[k] = k % 18 < 6 ? side.values[k % 18] : 0.0;
    }
    for (int k = 0; k < 6; k++) {
        reading[k] = servos_gain[k] * angles[k] + servos_zero_at[k];
    }
    if (pose_step(&controller, reading, reference, 0.0, command) != 0) {
        pose_init(&controller);
        return;
    }
    for (int k = 0; k < 6; k++) {
        command[k] = (command[k] - servos_zero_at[k]) / servos_gain[k];
        if (!(command[k] >= servos_low[k] && command[k] <= servos_high[k])) {
            return;
        }
    }
    memcpy(goal, command, sizeof goal);
}
#endif

/* A straight line of all cranks to the goal, as far as they get in a tick. */
static void approach(void)
{
    const double period = 1e-6 * SERVOS_PERIOD_US;
    double largest = 0.0, share = 1.0;
    for (int k = 0; k < 6; k++) {
        largest = fmax(largest, fabs(goal[k] - angles[k]));
    }
    if (largest > speed * period) {
        share = speed * period / largest;
        speed = fmin(SERVOS_FASTEST, speed + SERVOS_SLOW * period);
    } else {
        speed = SERVOS_FASTEST;
    }
    for (int k = 0; k < 6; k++) {
        angles[k] += share * (goal[k] - angles[k]);
    }
}

static void command_servos(void)
{
    uint16_t commands[6];
    for (int k = 0; k < 6; k++) {
        commands[k] = hexapod_command(k, angles[k]);
    }
    board_servos(commands);
}

static void tick(void)
{
    uint16_t commands[6];
    float values[6];
    const int holds = sd_holds(&side, now_us);
    if (!holds) {
#if SERVOS_POSES
        if (side.kind == SD_POSE) {
            goal_from_pose();
        }
#endif
        for (int k = 0; k < 6 && side.kind != SD_POSE; k++) {
            goal[k] = side.values[k];
        }
    } else {
        const int rests = SERVOS_REST_US > 0 && side.heard && now_us - side.heard_us > SERVOS_REST_US;
        memcpy(goal, rests ? servos_home : angles, sizeof goal);
    }
    approach();
    if (holds) {
        speed = SERVOS_SLOW;
    }
    command_servos();
    if (!sd_asked(&side, now_us) || (side.measured && board_positions(commands) != 1)) {
        return;
    }
    for (int k = 0; k < 6; k++) {
        values[k] = (float)(side.measured ? hexapod_angle(k, commands[k]) : angles[k]);
    }
    uint8_t out[SD_FRAME];
    board_write(out, (unsigned)sd_reading(&side, values, now_us, out));
}

static void take(uint8_t byte)
{
    uint8_t bytes[SD_FRAME];
    sd_packet packet;
    if (byte != 0) {
        if (used < SD_FRAME) { /* a longer one is no frame */
            frame[used++] = byte;
        }
        return;
    }
    if (sd_decode(bytes, sd_from_frame(frame, used, bytes), &packet)) {
        sd_take(&side, &packet, now_us);
    }
    used = 0;
}

void hexapod_begin(void)
{
    uint16_t commands[6];
    int told;
    board_begin(SERVOS_BAUD, SERVOS_PERIOD_US);
    do { /* until all servos have told where they are */
        told = board_positions(commands);
    } while (told == 0);
    memset(&side, 0, sizeof side);
    side.measured = told > 0;
    side.poses = SERVOS_POSES;
    for (int k = 0; k < 6; k++) {
        side.low[k] = (float)servos_low[k] - 1e-6f; /* rounding; pulses have limits of their own */
        side.high[k] = (float)servos_high[k] + 1e-6f;
        angles[k] = told > 0 ? hexapod_angle(k, commands[k]) : servos_home[k];
    }
#if SERVOS_POSES
    pose_init(&controller);
#endif
    speed = SERVOS_SLOW;
    command_servos();
    clock_us = board_micros();
}

void hexapod_poll(void)
{
    const uint32_t clock = board_micros();
    now_us += (uint32_t)(clock - clock_us);
    clock_us = clock;
    for (int n = 0, byte; n < 256 && (byte = board_getc()) >= 0; n++) {
        take((uint8_t)byte);
    }
    if (now_us >= due_us) {
        due_us += SERVOS_PERIOD_US;
        if (due_us <= now_us) { /* ticks that have gone by are left out */
            due_us = now_us + SERVOS_PERIOD_US;
        }
        tick();
    }
}
