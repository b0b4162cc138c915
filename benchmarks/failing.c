/* Counts the calls that create, write, cut, flush and rename files, and lets one of them fail.
   `benchmarks.failed_writes` compiles it and loads it before the C library. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static long seen, wanted = -1; /* below zero: not counting */
static int code;

void fail_at(long call, int error) { seen = 0, wanted = call, code = error; }
long calls_seen(void) { return seen; }

static int fails(void) {
    if (wanted < 0 || __atomic_add_fetch(&seen, 1, __ATOMIC_SEQ_CST) != wanted) return 0;
    errno = code;
    return 1;
}

static int fails_on(int file) { /* pipes, sockets and screens are not meant */
    struct stat status;
    if (wanted < 0 || fstat(file, &status)) return 0;
    return (S_ISREG(status.st_mode) || S_ISDIR(status.st_mode)) && fails();
}

#define TRUE_CALL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define ON_FILE(result, name, given, passed) \
    result name given { return fails_on(file) ? -1 : TRUE_CALL(name) passed; }
#define ON_NAME(name, given, passed) \
    int name given { return fails() ? -1 : TRUE_CALL(name) passed; }
#define OPENING(name)                                           \
    int name(const char *path, int flags, ...) {                \
        va_list more;                                           \
        va_start(more, flags);                                  \
        int mode = flags & O_CREAT ? va_arg(more, int) : 0;     \
        va_end(more);                                           \
        if (flags & (O_CREAT | O_TRUNC) && fails()) return -1;  \
        return TRUE_CALL(name)(path, flags, mode);              \
    }

ON_FILE(ssize_t, write, (int file, const void *from, size_t size), (file, from, size))
ON_FILE(ssize_t, pwrite, (int file, const void *from, size_t size, off_t at), (file, from, size, at))
ON_FILE(ssize_t, pwrite64, (int file, const void *from, size_t size, off64_t at), (file, from, size, at))
ON_FILE(ssize_t, writev, (int file, const struct iovec *from, int count), (file, from, count))
ON_FILE(int, fsync, (int file), (file))
ON_FILE(int, fdatasync, (int file), (file))
ON_FILE(int, ftruncate, (int file, off_t size), (file, size))
ON_FILE(int, ftruncate64, (int file, off64_t size), (file, size))
ON_NAME(rename, (const char *from, const char *to), (from, to))
ON_NAME(link, (const char *from, const char *to), (from, to))
ON_NAME(mkdir, (const char *path, mode_t mode), (path, mode))
OPENING(open)
OPENING(open64)
