"""Betaflight's SITL: a C program that is the vehicle, and talks to the firmware as Gazebo does.

The firmware sends four motor commands by UDP and takes the vehicle's state. The program steps the vehicle
every millisecond of wall time. It needs a C compiler and POSIX sockets, and nothing else.
"""

from __future__ import annotations

from string import Template

from flysid.errors import UsageError
from flysid.export.vehicles.csource import vehicle_header
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import DELAY
from flysid.sixdof.rigid_body import GRAVITY

MOTORS = 4
STEP_S = 0.001

_MAIN = """
/* cc -O2 vehicle_betaflight.c -o vehicle_betaflight -lm
   ./vehicle_betaflight [firmware's address] [port of motors, 9002] [port of state, 9003]
   Start betaflight_SITL.elf with the address of this program. */
#include <arpa/inet.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define STEP $step
#define LATE $late

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Where the ground carries, nothing sinks, and turning dies out. */
static int stand(double *x) {
  if (x[2] > 0.0) return 0;
  x[2] = 0.0;
  for (int i = 3; i < 6; i++) x[i] = 0.0;
  for (int i = 10; i < 13; i++) x[i] *= 0.98;
  return 1;
}

int main(int count, char **word) {
  const char *host = count > 1 ? word[1] : "127.0.0.1";
  const int motors = count > 2 ? atoi(word[2]) : 9002, state = count > 3 ? atoi(word[3]) : 9003;
  struct sockaddr_in in = {0}, out = {0};
  in.sin_family = out.sin_family = AF_INET;
  in.sin_addr.s_addr = htonl(INADDR_ANY);
  in.sin_port = htons((unsigned short)motors);
  out.sin_port = htons((unsigned short)state);
  const int from = socket(AF_INET, SOCK_DGRAM, 0), to = socket(AF_INET, SOCK_DGRAM, 0);
  if (inet_pton(AF_INET, host, &out.sin_addr) != 1 || from < 0 || to < 0
      || bind(from, (struct sockaddr *)&in, sizeof in) != 0 || fcntl(from, F_SETFL, O_NONBLOCK) != 0) {
    fprintf(stderr, "%s: no such address, or port %d is taken\\n", host, motors);
    return 1;
  }
  static const int place[VEHICLE_MOTORS] = {3, 0, 1, 2}; /* of motors 1 to 4 in the firmware's packet */
  static const double calm[3] = {0.0, 0.0, 0.0};
  double x[VEHICLE_STATES] = {0.0}, d[VEHICLE_STATES], queue[LATE + 1][VEHICLE_MOTORS] = {{0.0}};
  double packet[18] = {0.0}, flown = now();
  x[6] = 1.0;
  for (;;) {
    float given[4];
    while (recv(from, given, sizeof given, 0) == (long)sizeof given)
      for (int i = 0; i < VEHICLE_MOTORS; i++)
        queue[0][i] = given[place[i]] > 1.0f ? 1.0 : given[place[i]] > 0.0f ? given[place[i]] : 0.0;
    for (const double until = now(); flown < until; flown += STEP) {
      vehicle_step(x, queue[LATE], calm, STEP);
      stand(x);
      memmove(queue[1], queue[0], sizeof queue - sizeof queue[0]);
    }
    vehicle_derivative(x, queue[LATE], calm, d);
    const double w = x[6], a = x[7], b = x[8], c = x[9];
    const double held = x[2] > 0.0 ? 1.0 : 0.0; /* on the ground, the ground holds it */
    const double f[3] = {held * d[3], held * d[4], held * d[5] + $gravity};
    packet[0] += 0.05; /* stamps that are closer let the firmware's clock run ahead */
    packet[1] = x[10], packet[2] = -x[11], packet[3] = -x[12];
    const double r[3][3] = {
        {w * w + a * a - b * b - c * c, 2.0 * (a * b + w * c), 2.0 * (a * c - w * b)},
        {2.0 * (a * b - w * c), w * w - a * a + b * b - c * c, 2.0 * (b * c + w * a)},
        {2.0 * (a * c + w * b), 2.0 * (b * c - w * a), w * w - a * a - b * b + c * c}};
    for (int i = 0; i < 3; i++) packet[4 + i] = -(r[i][0] * f[0] + r[i][1] * f[1] + r[i][2] * f[2]);
    memcpy(packet + 7, x + 6, 4 * sizeof *x);
    memcpy(packet + 11, x + 3, 3 * sizeof *x);
    memcpy(packet + 14, x, 3 * sizeof *x);
    packet[17] = 101325.0 - 12.0 * x[2]; /* Pa */
    sendto(to, packet, sizeof packet, 0, (struct sockaddr *)&out, sizeof out);
    const struct timespec rest = {0, 500000};
    nanosleep(&rest, NULL);
  }
}
"""


def betaflight_source(vehicle: FittedVehicle) -> str:
    """The program, as text.

    Raises UsageError: the vehicle has not four motors, which is what the firmware sends.
    """
    if vehicle.motors != MOTORS:
        raise UsageError(f"Betaflight's SITL sends commands of {MOTORS} motors, not of {vehicle.motors}")
    late = round(float(vehicle.theta[DELAY]) / STEP_S)
    main = Template(_MAIN).substitute(step=STEP_S, late=max(late, 0), gravity=repr(GRAVITY))
    return "#define _POSIX_C_SOURCE 200809L\n" + vehicle_header(vehicle) + main
