// Fails a chosen call on files, or ends or stops the process there: preloaded into the programs by `cargo xtask faults`.
//
// What counts are calls on files in the current folder: those that are opened by a relative path or by one in PBGI_FAULT_FOLDER, and
// what is read from, written to and synced of them. Everything else of the process, its libraries and consoles, is left alone.
//
//   PBGI_FAULT_KIND    open, read, write, sync, rename, or full: writes fail once so many bytes are written
//   PBGI_FAULT_AT      which call, from 1; of full, how many bytes there is room for
//   PBGI_FAULT_DO      fail (with EMFILE, EIO or ENOSPC), kill or stop
//   PBGI_FAULT_COUNTS  a file to which the numbers of calls of each kind and of bytes are written at the end
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum kind { OPEN, READ, WRITE, SYNC, RENAME, FULL, NONE };
static const char *const NAMES[] = {"open", "read", "write", "sync", "rename", "full"};
static const int ERRORS[] = {EMFILE, EIO, EIO, EIO, EIO, ENOSPC};

#define FILES 4096
static atomic_char tracked[FILES];
static atomic_long calls[NONE];
static atomic_long bytes_written;
static enum kind fault_kind = NONE;
static long fault_at;
static int fault_signal;
static const char *folder;

#define REAL(name) ({ static __typeof__(&name) real; if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name); real; })

__attribute__((constructor)) static void start(void) {
    const char *kind = getenv("PBGI_FAULT_KIND"), *at = getenv("PBGI_FAULT_AT"), *what = getenv("PBGI_FAULT_DO");
    folder = getenv("PBGI_FAULT_FOLDER");
    if (!kind || !at || !what) return;
    for (int i = 0; i < NONE; i++)
        if (!strcmp(kind, NAMES[i])) fault_kind = i;
    fault_at = atol(at);
    fault_signal = !strcmp(what, "kill") ? SIGKILL : !strcmp(what, "stop") ? SIGSTOP : 0;
}

__attribute__((destructor)) static void report(void) {
    const char *path = getenv("PBGI_FAULT_COUNTS");
    FILE *file = path ? fopen(path, "w") : NULL;
    if (!file) return;
    for (int i = 0; i < FULL; i++) fprintf(file, "%s %ld\n", NAMES[i], atomic_load(&calls[i]));
    fprintf(file, "full %ld\n", atomic_load(&bytes_written));
    fclose(file);
}

// Whether this call is the chosen one and is to fail.
static int fails(enum kind kind) {
    long call = atomic_fetch_add(&calls[kind], 1) + 1;
    if (kind != fault_kind || call != fault_at) return 0;
    if (fault_signal) {
        kill(getpid(), fault_signal);
        return 0;
    }
    errno = ERRORS[kind];
    return 1;
}

static int is_tracked(int fd) { return fd >= 0 && fd < FILES && atomic_load(&tracked[fd]); }

static int is_ours(const char *path) {
    static const char FDS[] = "/proc/self/fd/";
    if (path[0] != '/') return 1;
    if (!strncmp(path, FDS, sizeof FDS - 1)) return is_tracked(atoi(path + sizeof FDS - 1));
    return folder && !strncmp(path, folder, strlen(folder));
}

static int track(int fd) {
    if (fd >= 0 && fd < FILES) atomic_store(&tracked[fd], 1);
    return fd;
}

// How many of so many bytes there is room for; below 0 if for none.
static ssize_t room(size_t count) {
    long before = atomic_fetch_add(&bytes_written, (long)count);
    if (fault_kind != FULL || before + (long)count <= fault_at) return (ssize_t)count;
    if (before >= fault_at) {
        errno = ENOSPC;
        return -1;
    }
    return fault_at - before;
}

#define MODE(flags) ({ mode_t mode = 0; if ((flags) & (O_CREAT | O_TMPFILE)) { va_list list; va_start(list, flags); \
    mode = va_arg(list, mode_t); va_end(list); } mode; })
#define OPENING(path, call) do { if (!is_ours(path)) return call; if (fails(OPEN)) return -1; return track(call); } while (0)

int open(const char *path, int flags, ...) {
    mode_t mode = MODE(flags);
    OPENING(path, REAL(open)(path, flags, mode));
}

int open64(const char *path, int flags, ...) {
    mode_t mode = MODE(flags);
    OPENING(path, REAL(open64)(path, flags, mode));
}

int openat(int at, const char *path, int flags, ...) {
    mode_t mode = MODE(flags);
    OPENING(path, REAL(openat)(at, path, flags, mode));
}

int openat64(int at, const char *path, int flags, ...) {
    mode_t mode = MODE(flags);
    OPENING(path, REAL(openat64)(at, path, flags, mode));
}

int close(int fd) {
    if (fd >= 0 && fd < FILES) atomic_store(&tracked[fd], 0);
    return REAL(close)(fd);
}

#define READING(call) do { if (is_tracked(fd) && fails(READ)) return -1; return call; } while (0)

ssize_t read(int fd, void *to, size_t count) { READING(REAL(read)(fd, to, count)); }
ssize_t pread(int fd, void *to, size_t count, off_t at) { READING(REAL(pread)(fd, to, count, at)); }
ssize_t pread64(int fd, void *to, size_t count, off64_t at) { READING(REAL(pread64)(fd, to, count, at)); }
ssize_t readv(int fd, const struct iovec *to, int count) { READING(REAL(readv)(fd, to, count)); }

#define WRITING(call) do { if (is_tracked(fd)) { if (fails(WRITE)) return -1; ssize_t left = room(count); if (left < 0) return -1; \
    count = (size_t)left; } return call; } while (0)

ssize_t write(int fd, const void *from, size_t count) { WRITING(REAL(write)(fd, from, count)); }
ssize_t pwrite(int fd, const void *from, size_t count, off_t at) { WRITING(REAL(pwrite)(fd, from, count, at)); }
ssize_t pwrite64(int fd, const void *from, size_t count, off64_t at) { WRITING(REAL(pwrite64)(fd, from, count, at)); }

ssize_t writev(int fd, const struct iovec *from, int pieces) {
    if (!is_tracked(fd)) return REAL(writev)(fd, from, pieces);
    // Piece by piece, as a system may.
    return pieces == 0 ? 0 : write(fd, from[0].iov_base, from[0].iov_len);
}

#define SYNCING(call) do { if (is_tracked(fd) && fails(SYNC)) return -1; return call; } while (0)

int fsync(int fd) { SYNCING(REAL(fsync)(fd)); }
int fdatasync(int fd) { SYNCING(REAL(fdatasync)(fd)); }

#define RENAMING(path, call) do { if (is_ours(path) && fails(RENAME)) return -1; return call; } while (0)

int rename(const char *from, const char *to) { RENAMING(to, REAL(rename)(from, to)); }
int renameat(int a, const char *from, int b, const char *to) { RENAMING(to, REAL(renameat)(a, from, b, to)); }
int renameat2(int a, const char *from, int b, const char *to, unsigned flags) { RENAMING(to, REAL(renameat2)(a, from, b, to, flags)); }
