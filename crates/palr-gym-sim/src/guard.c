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
extern void mj_step(const mjModel* m, mjData* d);
extern void mj_forward(const mjModel* m, mjData* d);
extern void mj_rnePostConstraint(const mjModel* m, mjData* d);

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
