/* Faults at the n-th operation on files below a folder: preloaded by scripts/bench kills.

   cc -shared -fPIC -o shim.so kills_shim.c -ldl

   Armed by shim_arm, or by KILLS_FOLDER, KILLS_MODE, KILLS_AT and KILLS_RANK in the environment, on one rank of Open MPI.
   KILLS_COUNT names a file for the number of operations there were; KILLS_PID one for the process id of rank 1. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { COUNT, KILL, HALF_KILL, FULL, FULL_ONCE, EIO_ONCE, HALF_FULL, TERM, INT, OTHER };

static char folder[4096];
static int mode, armed, is_full;
static long at, seen;

void shim_arm(const char *path, int what, long when) {
  strncpy(folder, path, sizeof folder - 1);
  mode = what, at = when, seen = 0, is_full = 0, armed = 1;
}

long shim_seen(void) { return seen; }

__attribute__((constructor)) static void begin(void) {
  const char *path = getenv("KILLS_FOLDER"), *rank = getenv("OMPI_COMM_WORLD_RANK"), *mine = getenv("KILLS_RANK");
  const char *pid = getenv("KILLS_PID");
  if (!path || !rank || !mine || getenv("KILLS_TAKEN_UP")) return;
  setenv("KILLS_TAKEN_UP", "1", 1); /* Gmsh and other children are left alone */
  if (pid && atoi(rank) == 1) {
    FILE *file = fopen(pid, "w");
    if (file) fprintf(file, "%d", (int)getpid()), fclose(file);
  }
  if (atoi(rank) == atoi(mine)) shim_arm(path, atoi(getenv("KILLS_MODE")), atol(getenv("KILLS_AT")));
}

__attribute__((destructor)) static void end(void) {
  const char *path = getenv("KILLS_COUNT");
  if (armed && path) {
    armed = 0;
    FILE *file = fopen(path, "w");
    if (file) fprintf(file, "%ld", seen), fclose(file);
  }
}

static int below(const char *path) {
  return armed && path && strncmp(path, folder, strlen(folder)) == 0 && path[strlen(folder)] == '/';
}

static int ours(int file) {
  char link[64], path[4096];
  if (!armed || file < 3) return 0;
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  ssize_t size = readlink(link, path, sizeof path - 1);
  if (size <= 0) return 0;
  path[size] = 0;
  return below(path);
}

static void die(void) {
  kill(getpid(), SIGKILL);
  pause();
}

static void kill_other(void) {
  int pid = 0;
  const char *path = getenv("KILLS_PID");
  FILE *file = path ? fopen(path, "r") : NULL;
  if (file && fscanf(file, "%d", &pid) == 1 && pid > 1) kill(pid, SIGKILL);
  if (file) fclose(file);
}

/* 0: go on; HALF_KILL, HALF_FULL: write a half first; else an error is set */
static int fault(void) {
  if (is_full) { errno = ENOSPC; return FULL; }
  if (++seen != at) return 0;
  switch (mode) {
    case KILL: die(); break;
    case FULL: is_full = 1; errno = ENOSPC; return FULL;
    case FULL_ONCE: errno = ENOSPC; return FULL;
    case EIO_ONCE: errno = EIO; return FULL;
    case HALF_KILL: case HALF_FULL: return mode;
    case TERM: kill(getpid(), SIGTERM); break;
    case INT: kill(getpid(), SIGINT); break;
    case OTHER: kill_other(); break;
  }
  return 0;
}

#define REAL(type, name, ...) \
  static type (*real)(__VA_ARGS__); \
  if (!real) real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name)

/* what cannot be done by halves */
static int whole(void) {
  int found = fault();
  if (found == HALF_KILL) die();
  if (found == HALF_FULL) { is_full = 1; errno = ENOSPC; }
  return found;
}

#define WRITE(name, arguments, half, all, ...) \
  ssize_t name arguments { \
    REAL(ssize_t, name, __VA_ARGS__); \
    if (!ours(file)) return all; \
    int found = fault(); \
    if (found == FULL) return -1; \
    if (found == HALF_KILL) { if (half < 0) die(); die(); } \
    if (found == HALF_FULL) { is_full = 1; return half; } \
    return all; \
  }
WRITE(write, (int file, const void *data, size_t size), real(file, data, (size + 1) / 2), real(file, data, size),
      int, const void *, size_t)
WRITE(pwrite, (int file, const void *data, size_t size, off_t to), real(file, data, (size + 1) / 2, to),
      real(file, data, size, to), int, const void *, size_t, off_t)
WRITE(pwrite64, (int file, const void *data, size_t size, off64_t to), real(file, data, (size + 1) / 2, to),
      real(file, data, size, to), int, const void *, size_t, off64_t)
WRITE(writev, (int file, const struct iovec *data, int count), real(file, data, (count + 1) / 2), real(file, data, count),
      int, const struct iovec *, int)

#define WHOLE(name, arguments, test, call, ...) \
  int name arguments { \
    REAL(int, name, __VA_ARGS__); \
    return test && whole() ? -1 : call; \
  }
WHOLE(rename, (const char *from, const char *to), below(to), real(from, to), const char *, const char *)
WHOLE(unlink, (const char *path), below(path), real(path), const char *)
WHOLE(rmdir, (const char *path), below(path), real(path), const char *)
WHOLE(mkdir, (const char *path, mode_t bits), below(path), real(path, bits), const char *, mode_t)
WHOLE(fsync, (int file), ours(file), real(file), int)
WHOLE(fdatasync, (int file), ours(file), real(file), int)
WHOLE(ftruncate, (int file, off_t size), ours(file), real(file, size), int, off_t)
WHOLE(ftruncate64, (int file, off64_t size), ours(file), real(file, size), int, off64_t)
WHOLE(truncate, (const char *path, off_t size), below(path), real(path, size), const char *, off_t)
WHOLE(truncate64, (const char *path, off64_t size), below(path), real(path, size), const char *, off64_t)

#define OPEN(name) \
  int name(const char *path, int flags, ...) { \
    va_list rest; \
    va_start(rest, flags); \
    mode_t bits = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0; \
    va_end(rest); \
    REAL(int, name, const char *, int, ...); \
    return flags & O_CREAT && below(path) && whole() ? -1 : real(path, flags, bits); \
  }
OPEN(open)
OPEN(open64)
