/* The clockwork of flexjoint around generated functions: physics at f_s, controller at f_c by an integer
   counter, torques held in between, delays by looking rows up. It follows flexjoint/simulation/compiled/model.py line by
   line; arithmetic on times and delays is in the same order, so that both take the same branches.

   Above: fj_step, generated or of newton.c; generated fj_signals, fj_control, fj_observe and
   the sizes FJ_*. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef long long fj_int;

enum { FJ_WATCH = 64 }; /* steps between two looks for numbers that are not finite */

typedef struct {
  double *x;                   /* (window, FJ_NX) states; row r lies at r % window */
  double *tau_m;               /* (window, FJ_NU) commanded torques */
  double *y;                   /* (window, FJ_NY) true signals that the law reads; used with delays only */
  const double *constants;     /* (FJ_NC) of fj_setup */
  const double *torque;        /* (steps, FJ_NU) given torques, or null: the law commands */
  const double *reference;     /* (ticks, FJ_NR), or one row for all */
  const double *gains;         /* (FJ_NG) */
  const double *command_delay; /* (FJ_NU) in rows, or null */
  const double *reading_delay; /* (FJ_NY) in rows, or null */
  double *kept_x;              /* (kept rows, FJ_NX) every stride-th row, or null */
  double *kept_tau_m;          /* (kept rows, FJ_NU) */
  double *summary;             /* (4, FJ_NO) least, largest, sum, sum of squares, or null */
  fj_int window, first;        /* rows; the row of the start */
  fj_int begin, end;           /* steps to take, counted from the start */
  fj_int tick_count, tick_steps; /* f_c / f_s as a fraction */
  fj_int reference_step;       /* from a tick's row of references to the next: FJ_NR, or 0 */
  fj_int fresh;                /* whether signals of the rows behind have still to be computed */
  fj_int stride, q_ref;          /* q_ref: its place in a row of reference, -1: none */
  fj_int worst;                /* out: the unknown for which a step did not converge, or -1 */
  fj_int fill;                 /* whether the first command also holds before the start */
  double t_start, t, h;        /* [s] time at the start, at step `begin`, of a step */
} fj_run;

static double fj_earlier(const double *table, fj_int width, fj_int window, fj_int column, fj_int row,
                         double delay) {
  double whole = ceil(delay), share, low;
  fj_int place;
  if (delay >= (double)row) return table[column]; /* row 0, never overwritten while it counts */
  place = row - (fj_int)whole;
  share = whole - delay;
  low = table[(place % window) * width + column];
  if (share == 0.0) return low;
  return (1.0 - share) * low + share * table[((place + 1) % window) * width + column];
}

/* The latest tick at or before a step. */
static fj_int fj_last(const fj_run *run, fj_int step) { return step * run->tick_count / run->tick_steps; }

static void fj_true(const fj_run *run, fj_int row, double *y) {
  const double *arg[3];
  double *res[1], time = run->t_start + run->h * (double)(row - run->first);
  arg[0] = run->x + (row % run->window) * FJ_NX;
  arg[1] = run->constants;
  arg[2] = &time;
  res[0] = y;
  fj_signals(arg, res, 0, 0, 0);
}

static void fj_command(const fj_run *run, fj_int k, double *tau) {
  const double *arg[5];
  double *res[1], y[FJ_NY + 1], time;
  fj_int row = run->first + k, i;
  if (run->torque) {
    memcpy(tau, run->torque + k * FJ_NU, FJ_NU * sizeof(double));
    return;
  }
  if (k && fj_last(run, k) == fj_last(run, k - 1)) {
    memcpy(tau, run->tau_m + ((row - 1) % run->window) * FJ_NU, FJ_NU * sizeof(double));
    return;
  }
  if (run->reading_delay) {
    for (i = 0; i < FJ_NY; i++) y[i] = fj_earlier(run->y, FJ_NY, run->window, i, row, run->reading_delay[i]);
  } else {
    fj_true(run, row, y);
  }
  time = run->t_start + run->h * (double)k;
  arg[0] = y;
  arg[1] = run->reference + fj_last(run, k) * run->reference_step;
  arg[2] = run->gains;
  arg[3] = run->constants;
  arg[4] = &time;
  res[0] = tau;
  fj_control(arg, res, 0, 0, 0);
}

static void fj_sum_up(const fj_run *run, fj_int k, const double *x, const double *tau, double t) {
  const double *arg[4];
  double *res[1], o[FJ_NO + 1];
  double *least = run->summary, *largest = least + FJ_NO, *sum = largest + FJ_NO, *squares = sum + FJ_NO;
  fj_int i;
  arg[0] = x;
  arg[1] = tau;
  arg[2] = run->constants;
  arg[3] = &t;
  res[0] = o;
  fj_observe(arg, res, 0, 0, 0); /* q, dq, theta, dtheta, tau_t of the actuated joints */
  memcpy(o + 5 * FJ_NU, tau, FJ_NU * sizeof(double));
  for (i = 0; i < FJ_NU; i++) {
    double wanted = o[i];
    if (run->q_ref >= 0 && !run->torque)
      wanted = run->reference[fj_last(run, k) * run->reference_step + run->q_ref + i];
    o[6 * FJ_NU + i] = wanted - o[i];
  }
  for (i = 0; i < FJ_NO; i++) {
    if (o[i] < least[i]) least[i] = o[i];
    if (o[i] > largest[i]) largest[i] = o[i];
    sum[i] += o[i];
    squares[i] += o[i] * o[i];
  }
}

static int fj_finite(const double *x) {
  fj_int i;
  for (i = FJ_NQ; i < FJ_NQ + FJ_NV + 2 * FJ_NF; i++) /* v, theta, dtheta */
    if (!isfinite(x[i])) return 0;
  return 1;
}

static fj_int fj_steps(fj_run *run, double *work) {
  const double *arg[FJ_STEP_ARG];
  double *res[FJ_STEP_RES], late[FJ_NU + 1];
  fj_int k, i, row, failed;
  if (run->reading_delay && run->fresh) {
    const fj_int now = run->first + run->begin, oldest = now - run->window + 1;
    for (row = oldest > 0 ? oldest : 0; row <= now; row++)
      fj_true(run, row, run->y + (row % run->window) * FJ_NY);
    run->fresh = 0;
  }
  for (k = run->begin; k < run->end; k++) {
    double *x, *next, *tau;
    row = run->first + k;
    x = run->x + (row % run->window) * FJ_NX;
    next = run->x + ((row + 1) % run->window) * FJ_NX;
    tau = run->tau_m + (row % run->window) * FJ_NU;
    fj_command(run, k, tau);
    if (k == 0 && run->fill)
      for (i = 0; i < run->first; i++) memcpy(run->tau_m + i * FJ_NU, tau, FJ_NU * sizeof(double));
    if (run->summary) fj_sum_up(run, k, x, tau, run->t_start + run->h * (double)k);
    if (run->kept_x && k % run->stride == 0) {
      memcpy(run->kept_x + (k / run->stride) * FJ_NX, x, FJ_NX * sizeof(double));
      memcpy(run->kept_tau_m + (k / run->stride) * FJ_NU, tau, FJ_NU * sizeof(double));
    }
    arg[0] = x;
    arg[1] = tau;
    if (run->command_delay) {
      for (i = 0; i < FJ_NU; i++)
        late[i] = run->command_delay[i] > 0.0
                      ? fj_earlier(run->tau_m, FJ_NU, run->window, i, row, run->command_delay[i])
                      : tau[i];
      arg[1] = late;
    }
    arg[2] = run->constants;
    arg[3] = &run->t;
    res[0] = next;
    failed = fj_step(arg, res, 0, work, 0);
    if (failed) {
      memcpy(next, x, FJ_NX * sizeof(double)); /* nothing after it: the state before the step stays */
      run->worst = failed - 1;
      return k;
    }
    run->t += run->h;
    if (run->reading_delay) fj_true(run, row + 1, run->y + ((row + 1) % run->window) * FJ_NY);
    if ((k + 1) % FJ_WATCH == 0 && !fj_finite(next)) return k;
  }
  if (run->end > run->begin && !fj_finite(run->x + ((run->first + run->end) % run->window) * FJ_NX))
    return run->end - 1;
  return -1;
}

/* Take the steps [begin, end). Returns -1, or the step that did not converge (worst is not -1 then) or after
   which the state was not finite; -2 where memory is short. */
FJ_EXPORT fj_int flexjoint_run(fj_run *run) {
  double *work = malloc(FJ_STEP_W * sizeof(double));
  fj_int failed;
  run->worst = -1;
  failed = work ? fj_steps(run, work) : -2;
  free(work);
  return failed;
}
