//! All sessions of a server, within its limits.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use palr_gym_core::SceneOptions;
use palr_gym_sim::{SimError, SimulationThreads, Snapshot, VectorEnv, VectorOptions};

use crate::config::Limits;
use crate::error::ServerError;
use crate::session::{Encode, Session, SessionId};
use crate::vision::Vision;

/// All sessions of a server.
pub struct Sessions<E: Encode> {
    limits: Limits,
    threads: SimulationThreads,
    vision: Arc<Vision>,
    open: Mutex<Open<E>>,
}

struct Open<E: Encode> {
    sessions: HashMap<SessionId, Arc<Session<E>>>,
    /// Sessions and environments that are being built, so that two callers together cannot pass
    /// a limit that each alone would keep.
    building: usize,
    envs: usize,
    is_draining: bool,
}

impl<E: Encode> Sessions<E> {
    /// No sessions yet.
    pub fn new(limits: Limits, threads: SimulationThreads, vision: Arc<Vision>) -> Self {
        let open = Open { sessions: HashMap::new(), building: 0, envs: 0, is_draining: false };
        Self { limits, threads, vision, open: Mutex::new(open) }
    }

    /// Opens a session. Building environments takes about a millisecond for ten: call it where
    /// blocking is allowed.
    ///
    /// # Errors
    /// Wrong ids and numbers, limits, or [`ServerError::Draining`]; then nothing was opened.
    pub fn open(
        &self,
        env_id: &str,
        scene: Option<SceneOptions>,
        num_envs: u64,
        options: VectorOptions,
        encode: E,
    ) -> Result<Arc<Session<E>>, ServerError> {
        self.open_prepared((env_id, scene), num_envs, options, encode, |_| Ok(()))
    }

    /// Opens a session in the state of a snapshot; `decode` finds the encoding that its tag names.
    ///
    /// # Errors
    /// As by [`open`](Self::open), or what is wrong with the snapshot; then nothing was opened.
    pub fn open_snapshot(
        &self,
        snapshot: &[u8],
        decode: impl FnOnce(u8) -> Result<E, ServerError>,
    ) -> Result<Arc<Session<E>>, ServerError> {
        let snapshot = Snapshot::parse(snapshot).map_err(SimError::from)?;
        let num_envs = snapshot.num_envs as u64;
        let (encode, options) = (decode(snapshot.tag)?, snapshot.options);
        // Tasks without such a scene know only the default.
        let scene = (snapshot.scene != SceneOptions::default()).then_some(snapshot.scene);
        let kind = (snapshot.env_id, scene);
        self.open_prepared(kind, num_envs, options, encode, |env| env.restore(&snapshot))
    }

    fn open_prepared(
        &self,
        (env_id, scene): (&str, Option<SceneOptions>),
        num_envs: u64,
        options: VectorOptions,
        encode: E,
        prepare: impl FnOnce(&mut VectorEnv) -> Result<(), SimError>,
    ) -> Result<Arc<Session<E>>, ServerError> {
        let (task, spec, sight) = self.vision.resolve(env_id, scene)?;
        let max = self.limits.max_envs_per_session;
        let count = usize::try_from(num_envs)
            .ok()
            .filter(|count| (1..=max).contains(count))
            .ok_or(ServerError::NumEnvs { got: num_envs, max })?;
        self.reserve(count)?;
        let threads = self.threads.clone();
        let built = VectorEnv::seeing(task, spec, count, options, threads, sight)
            .and_then(|mut env| prepare(&mut env).map(|()| env));
        let mut open = self.lock();
        open.building -= 1;
        match built {
            Ok(env) => {
                let max_queued = self.limits.max_queued_requests;
                let session = Arc::new(Session::new(env, encode, self.threads.clone(), max_queued));
                open.sessions.insert(session.id(), Arc::clone(&session));
                Ok(session)
            }
            Err(error) => {
                open.envs -= count;
                Err(error.into())
            }
        }
    }

    fn reserve(&self, num_envs: usize) -> Result<(), ServerError> {
        let mut open = self.lock();
        if open.is_draining {
            return Err(ServerError::Draining);
        }
        let count = open.sessions.len() + open.building;
        if count >= self.limits.max_sessions {
            return Err(ServerError::TooManySessions { open: count });
        }
        let total = open.envs + num_envs;
        if total > self.limits.max_envs {
            let max = self.limits.max_envs;
            return Err(ServerError::TooManyEnvs { asked: num_envs, total, max });
        }
        open.building += 1;
        open.envs = total;
        Ok(())
    }

    /// The session that `id` names.
    ///
    /// # Errors
    /// [`ServerError::SessionNotFound`].
    pub fn get(&self, id: &str) -> Result<Arc<Session<E>>, ServerError> {
        SessionId::parse(id)
            .and_then(|id| self.lock().sessions.get(&id).cloned())
            .ok_or_else(|| self.not_found(id))
    }

    /// Closes the session that `id` names. Requests in its queue are still answered.
    ///
    /// # Errors
    /// [`ServerError::SessionNotFound`].
    pub fn close(&self, id: &str) -> Result<(), ServerError> {
        let session = SessionId::parse(id).and_then(|id| self.lock().remove(id));
        session.map(drop).ok_or_else(|| self.not_found(id))
    }

    /// Closes every session that has been idle for longer than the limit; returns how many.
    pub fn reap(&self) -> usize {
        let mut open = self.lock();
        let idle: Vec<SessionId> = open
            .sessions
            .values()
            .filter(|session| session.idle() > self.limits.session_idle)
            .map(|session| session.id())
            .collect();
        let reaped: Vec<_> = idle.iter().filter_map(|id| open.remove(*id)).collect();
        // Environments are freed after the lock.
        drop(open);
        reaped.len()
    }

    /// True while a request of any session is queued or worked on.
    pub fn is_at_work(&self) -> bool {
        self.lock().sessions.values().any(|session| session.is_at_work())
    }

    /// From now on no session is opened.
    pub fn drain(&self) {
        self.lock().is_draining = true;
    }

    /// True once [`drain`](Self::drain) was called.
    pub fn is_draining(&self) -> bool {
        self.lock().is_draining
    }

    fn not_found(&self, id: &str) -> ServerError {
        let idle_limit_s = self.limits.session_idle.as_secs();
        // What a stranger sent is quoted only so far.
        ServerError::SessionNotFound { id: id.chars().take(64).collect(), idle_limit_s }
    }

    fn lock(&self) -> MutexGuard<'_, Open<E>> {
        // Nothing panics while it holds the lock.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<E: Encode> Open<E> {
    fn remove(&mut self, id: SessionId) -> Option<Arc<Session<E>>> {
        let session = self.sessions.remove(&id)?;
        self.envs -= session.num_envs();
        Some(session)
    }
}
