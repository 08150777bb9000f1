// File system without locks: with WITHOUT_LOCKS=flock only those of flock(2) are missing, with =all those of fcntl(2), too.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

int flock(int descriptor, int operation) {
  (void)descriptor, (void)operation;
  errno = ENOLCK;
  return -1;
}

static int refuse_lock(const char *name, int descriptor, int command, void *argument) {
  const char *missing = getenv("WITHOUT_LOCKS");
  int is_lock = command == F_SETLK || command == F_SETLKW || command == F_GETLK || command == F_OFD_SETLK ||
                command == F_OFD_SETLKW || command == F_OFD_GETLK;
  if (is_lock && missing && strcmp(missing, "all") == 0) {
    errno = ENOLCK;
    return -1;
  }
  int (*real)(int, int, ...) = dlsym(RTLD_NEXT, name);
  return real(descriptor, command, argument);
}

#define REPLACE(NAME)                                       \
  int NAME(int descriptor, int command, ...) {              \
    va_list arguments;                                      \
    va_start(arguments, command);                           \
    void *argument = va_arg(arguments, void *);             \
    va_end(arguments);                                      \
    return refuse_lock(#NAME, descriptor, command, argument); \
  }

REPLACE(fcntl)
REPLACE(fcntl64)
