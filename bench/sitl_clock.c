/* The clock of a program that flies in step with a simulated vehicle, and the ports that it opens.
 *
 * Loaded before a firmware built for this machine (LD_PRELOAD), it answers clock_gettime and nanosleep of the
 * program's first thread from a clock of its own. That clock stops after every step and goes on when the
 * simulation says so. Neither a slow machine nor a loaded one changes a flight.
 *
 * FLYSID_CLOCK   "IN,OUT": descriptors to read a step from (three uint64: us at which to stop, packets sent by
 *                now, us to lose at once, as if the processor was busy with something else), and to report on
 *                (one uint64: us now). Without it the clock is the machine's.
 * FLYSID_PORTS   is added to every port that the program binds or sends to.
 *
 * Packets come in on threads of their own. The first thread waits until every packet that was sent by then has
 * been read and used: its reader is back in select().
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <netinet/in.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

/* A look at the clock takes this long, so that busy waits end. Naps are cut short: the firmware's main loop naps
 * for 50 us to spare a machine whose clock runs by itself, and would miss its steps of 125 us. */
#define LOOK_NS 250u
#define LONGEST_NAP_NS 10000u
#define PACKET_WAIT_S 2

static int clock_in = -1, clock_out = -1, port_shift;
static uint64_t now_ns = 1000000000u, until_ns = 1000000000u;
static uint64_t packets_used;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t used = PTHREAD_COND_INITIALIZER;
static __thread int holds_packet;

static int (*machine_clock)(clockid_t, struct timespec *);
static int (*machine_sleep)(const struct timespec *, struct timespec *);
static int (*machine_select)(int, fd_set *, fd_set *, fd_set *, struct timeval *);
static ssize_t (*machine_recvfrom)(int, void *, size_t, int, struct sockaddr *, socklen_t *);
static ssize_t (*machine_sendto)(int, const void *, size_t, int, const struct sockaddr *, socklen_t);
static int (*machine_bind)(int, const struct sockaddr *, socklen_t);

__attribute__((constructor)) static void begin(void)
{
    machine_clock = dlsym(RTLD_NEXT, "clock_gettime");
    machine_sleep = dlsym(RTLD_NEXT, "nanosleep");
    machine_select = dlsym(RTLD_NEXT, "select");
    machine_recvfrom = dlsym(RTLD_NEXT, "recvfrom");
    machine_sendto = dlsym(RTLD_NEXT, "sendto");
    machine_bind = dlsym(RTLD_NEXT, "bind");
    const char *ports = getenv("FLYSID_PORTS"), *clock = getenv("FLYSID_CLOCK");
    port_shift = ports ? atoi(ports) : 0;
    if (clock && sscanf(clock, "%d,%d", &clock_in, &clock_out) != 2) {
        clock_in = clock_out = -1;
    }
}

static int in_step(void)
{
    return clock_in >= 0 && syscall(SYS_gettid) == getpid();
}

static void wait_for_packets(uint64_t sent)
{
    struct timespec end;
    machine_clock(CLOCK_REALTIME, &end);
    end.tv_sec += PACKET_WAIT_S;
    pthread_mutex_lock(&lock);
    while (packets_used < sent && pthread_cond_timedwait(&used, &lock, &end) == 0) {
    }
    pthread_mutex_unlock(&lock);
}

/* Lets the clock run on, and stops it at the end of each step. */
static void pass(uint64_t ns)
{
    now_ns += ns;
    while (now_ns >= until_ns) {
        uint64_t told = now_ns / 1000u, next[3];
        if (write(clock_out, &told, sizeof told) != sizeof told || read(clock_in, next, sizeof next) != sizeof next) {
            _exit(0); /* the simulation is over */
        }
        until_ns = next[0] * 1000u;
        wait_for_packets(next[1]);
        now_ns += next[2] * 1000u;
    }
}

int clock_gettime(clockid_t which, struct timespec *ts)
{
    if (clock_in < 0) {
        return machine_clock(which, ts);
    }
    if (in_step()) {
        pass(LOOK_NS);
    }
    ts->tv_sec = now_ns / 1000000000u;
    ts->tv_nsec = now_ns % 1000000000u;
    return 0;
}

int nanosleep(const struct timespec *wanted, struct timespec *left)
{
    if (!in_step()) {
        return machine_sleep(wanted, left);
    }
    uint64_t ns = (uint64_t)wanted->tv_sec * 1000000000u + (uint64_t)wanted->tv_nsec;
    pass(ns < LONGEST_NAP_NS ? ns : LONGEST_NAP_NS);
    return 0;
}

int select(int n, fd_set *in, fd_set *out, fd_set *bad, struct timeval *longest)
{
    if (holds_packet) {
        holds_packet = 0;
        pthread_mutex_lock(&lock);
        packets_used++;
        pthread_cond_signal(&used);
        pthread_mutex_unlock(&lock);
    }
    return machine_select(n, in, out, bad, longest);
}

ssize_t recvfrom(int fd, void *to, size_t size, int flags, struct sockaddr *from, socklen_t *length)
{
    ssize_t got = machine_recvfrom(fd, to, size, flags, from, length);
    holds_packet |= got > 0;
    return got;
}

/* An address whose port is moved: it stands at the same place in both families. */
static struct sockaddr_storage shifted(const struct sockaddr *address, socklen_t length)
{
    struct sockaddr_storage own;
    memcpy(&own, address, length < sizeof own ? length : sizeof own);
    struct sockaddr_in *place = (struct sockaddr_in *)&own;
    place->sin_port = htons((uint16_t)(ntohs(place->sin_port) + port_shift));
    return own;
}

static int has_port(const struct sockaddr *address)
{
    return address && (address->sa_family == AF_INET || address->sa_family == AF_INET6);
}

int bind(int fd, const struct sockaddr *address, socklen_t length)
{
    if (!has_port(address)) {
        return machine_bind(fd, address, length);
    }
    struct sockaddr_storage own = shifted(address, length);
    return machine_bind(fd, (struct sockaddr *)&own, length);
}

ssize_t sendto(int fd, const void *what, size_t size, int flags, const struct sockaddr *to, socklen_t length)
{
    if (!has_port(to)) {
        return machine_sendto(fd, what, size, flags, to, length);
    }
    struct sockaddr_storage own = shifted(to, length);
    return machine_sendto(fd, what, size, flags, (struct sockaddr *)&own, length);
}
