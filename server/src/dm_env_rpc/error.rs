//! What a client of dm_env_rpc can do wrong.

/// Why a request over dm_env_rpc failed. Everything else is as in [`crate::ServerError`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DmEnvRpcError {
    /// A request without a payload, or of a kind that came after this server.
    #[error(
        "the request is empty or of an unknown kind; expected create_world, join_world, step, reset, reset_world, leave_world or destroy_world"
    )]
    NoRequest,
    /// Extensions are for servers and clients that agree on them.
    #[error("this server has no extensions; got one of type {type_url:?}")]
    NoExtension {
        /// The extension's type.
        type_url: String,
    },
    /// A setting that the request does not have.
    #[error("setting {name:?} is unknown; expected {known}")]
    UnknownSetting {
        /// Its name.
        name: String,
        /// Those that there are.
        known: &'static str,
    },
    /// A setting with a wrong value.
    #[error("setting {name:?} is {got}; expected {want}")]
    Setting {
        /// Its name.
        name: &'static str,
        /// What it is.
        got: String,
        /// What it should be.
        want: &'static str,
    },
    /// No world has this name.
    #[error(
        "world {world_name:?} not found: it was destroyed, not joined for more than {idle_limit_s} s, or never created on this server"
    )]
    UnknownWorld {
        /// The name as it came.
        world_name: String,
        /// After which worlds that nobody has joined are destroyed.
        idle_limit_s: u64,
    },
    /// A connection can join one world at a time.
    #[error("this connection has joined world {world_name:?} already; leave it first")]
    AlreadyJoined {
        /// The world.
        world_name: String,
    },
    /// A request that needs a world.
    #[error("this connection has joined no world; join one before {request}")]
    NotJoined {
        /// What was asked for.
        request: &'static str,
    },
    /// A world that is in use cannot be destroyed.
    #[error(
        "world {world_name:?} has {joined} joined connections; it can be destroyed when they have left"
    )]
    WorldInUse {
        /// The world.
        world_name: String,
        /// How many have joined it.
        joined: usize,
    },
    /// The server is full.
    #[error(
        "{open} worlds are open, as many as this server allows; destroy one or try again later"
    )]
    TooManyWorlds {
        /// How many there are.
        open: usize,
    },
    /// An id of no observation.
    #[error("no observation has the id {uid}; expected 1 (observation) or 2 (reward)")]
    UnknownObservation {
        /// The id.
        uid: u64,
    },
    /// An id of no action.
    #[error("no action has the id {uid}; expected 1 (action)")]
    UnknownAction {
        /// The id.
        uid: u64,
    },
    /// An action of another type.
    #[error("action has elements of type {got}; expected floats")]
    ActionType {
        /// The type.
        got: &'static str,
    },
    /// An action of another shape.
    #[error(
        "action has shape {shape:?} and {elements} elements; expected shape [{size}] or [-1], and {size} elements or a single one for all"
    )]
    ActionShape {
        /// The shape found.
        shape: Vec<i32>,
        /// The elements found.
        elements: usize,
        /// Entries of an action.
        size: usize,
    },
}
