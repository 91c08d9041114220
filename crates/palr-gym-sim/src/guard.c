// Calls of MuJoCo that return even if MuJoCo reports an error.
//
// mju_error() does not come back to the code that called it: its handler must end the process or
// jump. This file jumps back to where the call began. No Rust code lies in between, so nothing that
// Rust would have to clean up is skipped; what MuJoCo leaves half done is in mjData alone, which
// the caller throws away.

#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>

typedef struct mjModel_ mjModel;
typedef struct mjData_ mjData;

// As far as it is read here; see mjtype.h.
typedef struct mjLogMessage_ {
  int level;
  int topic;
  char subject[1024];
  const char* body;
  const char* func;
} mjLogMessage;
enum { LEVEL_ERROR = 3 };

typedef void (*mjfLogHandler)(const mjLogMessage*);
extern mjfLogHandler mju_setLogHandler(mjfLogHandler handler);
extern mjData* mj_makeData(const mjModel* m);
extern void mj_deleteData(mjData* d);
extern void mj_step(const mjModel* m, mjData* d);
extern void mj_forward(const mjModel* m, mjData* d);
extern void mj_rnePostConstraint(const mjModel* m, mjData* d);
extern void mj_kinematics(const mjModel* m, mjData* d);
extern void mj_comPos(const mjModel* m, mjData* d);
extern void mj_camlight(const mjModel* m, mjData* d);

// See mjrender.h and mjvisualize.h.
typedef struct mjrContext_ mjrContext;
typedef struct mjvScene_ mjvScene;
typedef struct mjvOption_ mjvOption;
typedef struct mjvPerturb_ mjvPerturb;
typedef struct mjvCamera_ mjvCamera;
typedef struct mjrRect_ {
  int left, bottom, width, height;
} mjrRect;
enum { OFFSCREEN = 1, FONT_SCALE = 100, EVERYTHING = 7 };

extern void mjr_makeContext(const mjModel* m, mjrContext* con, int fontscale);
extern void mjr_resizeOffscreen(int width, int height, mjrContext* con);
extern void mjr_setBuffer(int framebuffer, mjrContext* con);
extern void mjr_render(mjrRect viewport, mjvScene* scn, const mjrContext* con);
extern void mjr_readPixels(unsigned char* rgb, float* depth, mjrRect viewport,
                           const mjrContext* con);
extern void mjv_updateScene(const mjModel* m, mjData* d, const mjvOption* opt,
                            const mjvPerturb* pert, mjvCamera* cam, int catmask, mjvScene* scn);

// In guard.rs: hands a message to the program's log.
extern void palr_gym_log(int level, const char* func, const char* subject, const char* body);

static _Thread_local jmp_buf* way_back = NULL;
static _Thread_local char last_error[1200];

static void on_message(const mjLogMessage* message) {
  if (message->level != LEVEL_ERROR) {
    palr_gym_log(message->level, message->func, message->subject, message->body);
    return;
  }
  snprintf(last_error, sizeof(last_error), "%s%s%s", message->func ? message->func : "",
           message->func ? ": " : "", message->subject);
  if (way_back != NULL) {
    jmp_buf* back = way_back;
    way_back = NULL;
    _longjmp(*back, 1);
  }
  // Outside of these guards: MuJoCo must not go on.
  palr_gym_log(message->level, message->func, message->subject, message->body);
  abort();
}

void palr_gym_guard_install(void) { mju_setLogHandler(on_message); }

const char* palr_gym_guard_last_error(void) { return last_error; }

int palr_gym_guard_try_data(const mjModel* m) {
  jmp_buf here;
  if (_setjmp(here) != 0) return 1;
  way_back = &here;
  mj_deleteData(mj_makeData(m));
  way_back = NULL;
  return 0;
}

int palr_gym_guard_step(const mjModel* m, mjData* d, int steps) {
  jmp_buf here;
  if (_setjmp(here) != 0) return 1;
  way_back = &here;
  for (int i = 0; i < steps; i++) mj_step(m, d);
  way_back = NULL;
  return 0;
}

int palr_gym_guard_forward(const mjModel* m, mjData* d) {
  jmp_buf here;
  if (_setjmp(here) != 0) return 1;
  way_back = &here;
  mj_forward(m, d);
  way_back = NULL;
  return 0;
}

int palr_gym_guard_contact_forces(const mjModel* m, mjData* d) {
  jmp_buf here;
  if (_setjmp(here) != 0) return 1;
  way_back = &here;
  mj_rnePostConstraint(m, d);
  way_back = NULL;
  return 0;
}

int palr_gym_guard_make_context(const mjModel* m, mjrContext* con) {
  jmp_buf here;
  if (_setjmp(here) != 0) return 1;
  way_back = &here;
  mjr_makeContext(m, con, FONT_SCALE);
  way_back = NULL;
  return 0;
}

int palr_gym_guard_resize(int width, int height, mjrContext* con) {
  jmp_buf here;
  if (_setjmp(here) != 0) return 1;
  way_back = &here;
  mjr_resizeOffscreen(width, height, con);
  mjr_setBuffer(OFFSCREEN, con);
  way_back = NULL;
  return 0;
}

int palr_gym_guard_update_scene(const mjModel* m, mjData* d, const mjvOption* opt,
                                const mjvPerturb* pert, mjvCamera* cam, mjvScene* scn) {
  jmp_buf here;
  if (_setjmp(here) != 0) return 1;
  way_back = &here;
  mj_kinematics(m, d);
  mj_comPos(m, d);
  mj_camlight(m, d);
  mjv_updateScene(m, d, opt, pert, cam, EVERYTHING, scn);
  way_back = NULL;
  return 0;
}

int palr_gym_guard_draw(mjvScene* scn, mjrContext* con, int width, int height,
                        unsigned char* rgb) {
  jmp_buf here;
  if (_setjmp(here) != 0) return 1;
  way_back = &here;
  mjrRect viewport = {0, 0, width, height};
  // Several scenes share a thread's context, and each has a framebuffer of its own.
  mjr_setBuffer(OFFSCREEN, con);
  mjr_render(viewport, scn, con);
  mjr_readPixels(rgb, NULL, viewport, con);
  way_back = NULL;
  return 0;
}
