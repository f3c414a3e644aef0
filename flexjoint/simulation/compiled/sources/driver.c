/* The clockwork of flexjoint around generated functions: physics at f_s, controller at f_c by an integer
   counter, torques held in between, delays by looking rows up. It follows flexjoint/simulation/compiled/model.py line by
   line; arithmetic on times and delays is in the same order, so that both take the same branches. Several
   rollouts (lanes.c) share their times and ticks; all else is each one's own.

   Above: lanes.c; fj_step, generated or of newton.c; generated fj_signals, fj_control, fj_observe and
   the sizes FJ_*. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef long long fj_int;

enum { FJ_WATCH = 64 }; /* steps between two looks for numbers that are not finite */

enum { FJ_MOST = 8 };   /* lanes */

typedef struct {
  fj_real *x;                   /* (window, FJ_NX) states; row r lies at r % window */
  fj_real *tau_m;               /* (window, FJ_NU) commanded torques */
  fj_real *y;                   /* (window, FJ_NY) true signals that the law reads; used with delays only */
  const fj_real *constants;     /* (FJ_NC) of fj_setup */
  const double *torque;         /* (steps, FJ_NU) given torques, or null: the law commands */
  const double *reference;      /* (ticks, FJ_NR), or one row for all */
  const fj_real *gains;         /* (FJ_NG) */
  const fj_real *command_delay; /* (FJ_NU) in rows, or null */
  const fj_real *reading_delay; /* (FJ_NY) in rows, or null */
  double *kept_x;               /* (kept rows, FJ_NX) every stride-th row, or null */
  double *kept_tau_m;           /* (kept rows, FJ_NU) */
  fj_real *summary;             /* (4, FJ_NO) least, largest, sum, sum of squares, or null */
  fj_int window, first;         /* rows; the row of the start */
  fj_int begin, end;            /* steps to take, counted from the start */
  fj_int tick_count, tick_steps; /* f_c / f_s as a fraction */
  fj_int reference_step;        /* from a tick's row of references to the next: FJ_NR, or 0 */
  fj_int fresh;                 /* whether signals of the rows behind have still to be computed */
  fj_int stride, q_ref;         /* q_ref: its place in a row of reference, -1: none */
  fj_int worst;                 /* out: the unknown for which a step did not converge, or -1 */
  fj_int fill;                  /* whether the first command also holds before the start */
  fj_int drive_lane, kept_lane; /* from a lane's torques or references, and kept rows, to the next one's */
  fj_int failed[FJ_MOST];       /* out: of each lane the step after which it was not finite, or -1 */
  fj_int lost[FJ_MOST];         /* out: of each lane 1 + the first step that did not follow its motion, or 0 */
  double turned[FJ_MOST];       /* out: the most [rad] by which a link turned within such a step */
  double t_start, t, h;         /* [s] time at the start, at step `begin`, of a step */
} fj_run;

/* A row of each lane as numbers: `row` itself where there is one lane, else in `room`. */
static const fj_real *fj_given(const double *row, fj_int lane_step, fj_int count, fj_real *room) {
#ifdef FJ_MANY
  fj_int i;
  int lane;
  for (lane = 0; lane < FJ_LANES; lane++)
    for (i = 0; i < count; i++) room[i][lane] = row[lane * lane_step + i];
  return room;
#else
  (void)lane_step;
  (void)count;
  (void)room;
  return row;
#endif
}

static void fj_keep(const fj_real *row, fj_int count, fj_int lane_step, double *out) {
  fj_int i;
  int lane;
  for (lane = 0; lane < FJ_LANES; lane++)
    for (i = 0; i < count; i++) out[lane * lane_step + i] = FJ_AT(row, i, lane);
}

static double fj_earlier(const fj_real *table, fj_int width, fj_int window, fj_int column, fj_int row,
                         double delay, int lane) {
  double whole = ceil(delay), share, low;
  fj_int place;
  if (delay >= (double)row) return FJ_AT(table, column, lane); /* row 0, never overwritten while it counts */
  place = row - (fj_int)whole;
  share = whole - delay;
  low = FJ_AT(table, (place % window) * width + column, lane);
  if (share == 0.0) return low;
  return (1.0 - share) * low + share * FJ_AT(table, ((place + 1) % window) * width + column, lane);
}

/* The latest tick at or before a step. */
static fj_int fj_last(const fj_run *run, fj_int step) { return step * run->tick_count / run->tick_steps; }

static void fj_true(const fj_run *run, fj_int row, fj_real *y) {
  const fj_real *arg[3];
  fj_real *res[1], time = fj_all(run->t_start + run->h * (double)(row - run->first));
  arg[0] = run->x + (row % run->window) * FJ_NX;
  arg[1] = run->constants;
  arg[2] = &time;
  res[0] = y;
  fj_signals(arg, res, 0, 0, 0);
}

static void fj_command(const fj_run *run, fj_int k, fj_real *tau) {
  const fj_real *arg[5];
  fj_real *res[1], y[FJ_NY + 1], room[FJ_NR + 1], time;
  fj_int row = run->first + k, i;
  int lane;
  if (run->torque) {
    const fj_real *given = fj_given(run->torque + k * FJ_NU, run->drive_lane, FJ_NU, tau);
    if (given != tau) memcpy(tau, given, FJ_NU * sizeof(fj_real));
    return;
  }
  if (k && fj_last(run, k) == fj_last(run, k - 1)) {
    memcpy(tau, run->tau_m + ((row - 1) % run->window) * FJ_NU, FJ_NU * sizeof(fj_real));
    return;
  }
  if (run->reading_delay) {
    for (i = 0; i < FJ_NY; i++)
      for (lane = 0; lane < FJ_LANES; lane++)
        FJ_AT(y, i, lane) =
            fj_earlier(run->y, FJ_NY, run->window, i, row, FJ_AT(run->reading_delay, i, lane), lane);
  } else {
    fj_true(run, row, y);
  }
  time = fj_all(run->t_start + run->h * (double)k);
  arg[0] = y;
  arg[1] = fj_given(run->reference + fj_last(run, k) * run->reference_step, run->drive_lane, FJ_NR, room);
  arg[2] = run->gains;
  arg[3] = run->constants;
  arg[4] = &time;
  res[0] = tau;
  fj_control(arg, res, 0, 0, 0);
}

static void fj_sum_up(const fj_run *run, fj_int k, const fj_real *x, const fj_real *tau, double t) {
  const fj_real *arg[4], *wanted;
  fj_real o[FJ_NO + 1];
  fj_real *res[1], room[FJ_NU], time = fj_all(t);
  fj_real *least = run->summary, *largest = least + FJ_NO, *sum = largest + FJ_NO, *squares = sum + FJ_NO;
  fj_int i;
  arg[0] = x;
  arg[1] = tau;
  arg[2] = run->constants;
  arg[3] = &time;
  res[0] = o;
  fj_observe(arg, res, 0, 0, 0); /* q, dq, theta, dtheta, tau_t of the actuated joints */
  memcpy(o + 5 * FJ_NU, tau, FJ_NU * sizeof(fj_real));
  wanted = o;
  if (run->q_ref >= 0 && !run->torque)
    wanted = fj_given(run->reference + fj_last(run, k) * run->reference_step + run->q_ref, run->drive_lane,
                      FJ_NU, room);
  for (i = 0; i < FJ_NU; i++) o[6 * FJ_NU + i] = wanted[i] - o[i];
  for (i = 0; i < FJ_NO; i++) {
    least[i] = fj_pick(o[i] < least[i], o[i], least[i]);
    largest[i] = fj_pick(o[i] > largest[i], o[i], largest[i]);
    sum[i] += o[i];
    squares[i] += o[i] * o[i];
  }
}

static int fj_finite(const fj_real *x, int lane) {
  fj_int i;
  for (i = FJ_NQ; i < FJ_NQ + FJ_NV + 2 * FJ_NF; i++) /* v, theta, dtheta */
    if (!isfinite(FJ_AT(x, i, lane))) return 0;
  return 1;
}

/* Notes which lanes have left the finite numbers by the end of step k; whether one is left that has not. */
static int fj_watch(fj_run *run, const fj_real *x, fj_int k) {
  int lane, left = 0;
  for (lane = 0; lane < FJ_LANES; lane++) {
    if (run->failed[lane] < 0 && !fj_finite(x, lane)) run->failed[lane] = k;
    left |= run->failed[lane] < 0;
  }
  return left;
}

#ifdef FJ_FOLLOWED
/* Notes steps k of order 1, from x, in which a link turns by more than FJ_FOLLOWED. */
static void fj_lose(fj_run *run, fj_int k, const fj_real *x, fj_int lanes) {
  int lane, i;
  for (lane = 0; lane < FJ_LANES; lane++) {
    double turned = 0.0;
    if (!(lanes >> lane & 1)) continue;
    for (i = FJ_NQ + FJ_TURNING; i < FJ_NQ + FJ_NV; i++) turned = fmax(turned, run->h * fabs(FJ_AT(x, i, lane)));
    if (!(turned > FJ_FOLLOWED && turned < INFINITY)) continue;
    if (!run->lost[lane]) run->lost[lane] = k + 1;
    run->turned[lane] = fmax(run->turned[lane], turned);
  }
}
#else
#define fj_lose(run, k, x, lanes)
#endif

static fj_int fj_steps(fj_run *run, fj_real *work) {
  const fj_real *arg[FJ_STEP_ARG];
  fj_real *res[FJ_STEP_RES], late[FJ_NU + 1], time;
  fj_int k, i, row, failed;
  int lane;
  if (run->reading_delay && run->fresh) {
    const fj_int now = run->first + run->begin, oldest = now - run->window + 1;
    for (row = oldest > 0 ? oldest : 0; row <= now; row++)
      fj_true(run, row, run->y + (row % run->window) * FJ_NY);
    run->fresh = 0;
  }
  for (k = run->begin; k < run->end; k++) {
    fj_real *x, *next, *tau;
    row = run->first + k;
    x = run->x + (row % run->window) * FJ_NX;
    next = run->x + ((row + 1) % run->window) * FJ_NX;
    tau = run->tau_m + (row % run->window) * FJ_NU;
    fj_command(run, k, tau);
    if (k == 0 && run->fill)
      for (i = 0; i < run->first; i++) memcpy(run->tau_m + i * FJ_NU, tau, FJ_NU * sizeof(fj_real));
    if (run->summary) fj_sum_up(run, k, x, tau, run->t_start + run->h * (double)k);
    if (run->kept_x && k % run->stride == 0) {
      fj_keep(x, FJ_NX, run->kept_lane * FJ_NX, run->kept_x + (k / run->stride) * FJ_NX);
      fj_keep(tau, FJ_NU, run->kept_lane * FJ_NU, run->kept_tau_m + (k / run->stride) * FJ_NU);
    }
    arg[0] = x;
    arg[1] = tau;
    if (run->command_delay) {
      for (i = 0; i < FJ_NU; i++)
        for (lane = 0; lane < FJ_LANES; lane++) {
          const double delay = FJ_AT(run->command_delay, i, lane);
          FJ_AT(late, i, lane) = delay > 0.0
                                     ? fj_earlier(run->tau_m, FJ_NU, run->window, i, row, delay, lane)
                                     : FJ_AT(tau, i, lane);
        }
      arg[1] = late;
    }
    arg[2] = run->constants;
    time = fj_all(run->t);
    arg[3] = &time;
    res[0] = next;
    failed = fj_step(arg, res, 0, work, 0);
    if (failed < 0) {
      fj_lose(run, k, x, -failed);
    } else if (failed) {
      memcpy(next, x, FJ_NX * sizeof(fj_real)); /* nothing after it: the state before the step stays */
      run->worst = failed - 1;
      return k;
    }
    run->t += run->h;
    if (run->reading_delay) fj_true(run, row + 1, run->y + ((row + 1) % run->window) * FJ_NY);
    if ((k + 1) % FJ_WATCH == 0 && !fj_watch(run, next, k)) return k;
  }
  if (run->end > run->begin) {
    const fj_real *x = run->x + ((run->first + run->end) % run->window) * FJ_NX;
    if (!fj_watch(run, x, run->end - 1)) return run->end - 1;
  }
  return -1;
}

FJ_EXPORT int flexjoint_lanes(void) { return FJ_LANES; }

/* Take the steps [begin, end). Returns -1, or the step that did not converge (worst is not -1 then) or after
   which the state was not finite, in no lane; -2 where memory is short. */
FJ_EXPORT fj_int flexjoint_run(fj_run *run) {
  const size_t lane = sizeof(fj_real) - 1;
  void *own = malloc(FJ_STEP_W * sizeof(fj_real) + lane);
  fj_int failed = -2;
  run->worst = -1;
  if (own) failed = fj_steps(run, (fj_real *)(((uintptr_t)own + lane) & ~(uintptr_t)lane));
  free(own);
  return failed;
}
