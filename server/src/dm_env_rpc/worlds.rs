//! Every world of a server.
//!
//! A world is small: an id, a seed and a count. What costs memory and time, the environment, comes
//! with each connection that joins.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use uuid::Uuid;

use super::error::DmEnvRpcError;
use super::settings::{WorldSettings, quoted};

/// Every world of a server.
pub struct Worlds {
    open: Mutex<HashMap<String, World>>,
    max_worlds: usize,
    idle_limit: Duration,
}

struct World {
    settings: WorldSettings,
    /// How often it was reset.
    resets: u64,
    joined: usize,
    last_used: Instant,
}

/// A world as one that has joined it sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct View {
    /// How often it was reset.
    pub(super) resets: u64,
    /// From which the next episode starts after a reset or a join.
    pub(super) seed: Option<u64>,
}

/// A place in a world, given back when it is dropped.
pub(super) struct Place {
    worlds: Arc<Worlds>,
    world_name: String,
}

impl Worlds {
    /// No worlds yet. There may be `max_worlds`; those that nobody has joined for `idle_limit` are
    /// destroyed by [`reap`](Self::reap).
    #[must_use]
    pub fn new(max_worlds: usize, idle_limit: Duration) -> Self {
        Self { open: Mutex::default(), max_worlds, idle_limit }
    }

    /// Makes a world; returns its name.
    pub(super) fn create(&self, settings: WorldSettings) -> Result<String, DmEnvRpcError> {
        let mut open = self.lock();
        if open.len() >= self.max_worlds {
            return Err(DmEnvRpcError::TooManyWorlds { open: open.len() });
        }
        let world_name = Uuid::new_v4().to_string();
        let world = World { settings, resets: 0, joined: 0, last_used: Instant::now() };
        open.insert(world_name.clone(), world);
        Ok(world_name)
    }

    /// Destroys a world that nobody has joined.
    pub(super) fn destroy(&self, world_name: &str) -> Result<(), DmEnvRpcError> {
        let mut open = self.lock();
        let world = open.get(world_name).ok_or_else(|| self.unknown(world_name))?;
        if world.joined > 0 {
            let world_name = world_name.to_owned();
            return Err(DmEnvRpcError::WorldInUse { world_name, joined: world.joined });
        }
        open.remove(world_name);
        Ok(())
    }

    /// Takes a place in a world; also says what its environment is.
    pub(super) fn join(
        self: &Arc<Self>,
        world_name: &str,
    ) -> Result<(Place, String), DmEnvRpcError> {
        let mut open = self.lock();
        let world = open.get_mut(world_name).ok_or_else(|| self.unknown(world_name))?;
        world.joined += 1;
        let place = Place { worlds: Arc::clone(self), world_name: world_name.to_owned() };
        Ok((place, world.settings.env_id.clone()))
    }

    /// Interrupts every episode in a world; a seed replaces the world's.
    pub(super) fn reset(&self, world_name: &str, seed: Option<u64>) -> Result<(), DmEnvRpcError> {
        let mut open = self.lock();
        let world = open.get_mut(world_name).ok_or_else(|| self.unknown(world_name))?;
        world.resets += 1;
        world.last_used = Instant::now();
        world.settings.seed = seed.or(world.settings.seed);
        Ok(())
    }

    /// Destroys every world that nobody has joined for longer than the limit; returns how many.
    pub fn reap(&self) -> usize {
        let mut open = self.lock();
        let before = open.len();
        open.retain(|_, world| world.joined > 0 || world.last_used.elapsed() <= self.idle_limit);
        before - open.len()
    }

    /// How many worlds there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.lock().len()
    }

    /// True if there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn unknown(&self, world_name: &str) -> DmEnvRpcError {
        let idle_limit_s = self.idle_limit.as_secs();
        DmEnvRpcError::UnknownWorld { world_name: quoted(world_name), idle_limit_s }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, World>> {
        // Nothing panics while it holds the lock.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Place {
    pub(super) fn world_name(&self) -> &str {
        &self.world_name
    }

    /// The world as it is now.
    pub(super) fn view(&self) -> View {
        let open = self.worlds.lock();
        // A world with a place taken is neither destroyed nor reaped.
        let world = open.get(&self.world_name);
        View {
            resets: world.map_or(0, |world| world.resets),
            seed: world.and_then(|world| world.settings.seed),
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        if let Some(world) = self.worlds.lock().get_mut(&self.world_name) {
            world.joined -= 1;
            world.last_used = Instant::now();
        }
    }
}
