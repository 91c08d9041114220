//! The wire: generated messages and services of `palr_gym.v1`, and of
//! `dm_env_rpc.v1` for existing clients.
//!
//! Nothing is written by hand here but the module tree; what a message means stands beside its
//! fields in `proto/*/v1/*.proto`.
#![allow(missing_docs, unreachable_pub, clippy::all, reason = "generated code")]

/// Every file that the services need, for server reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// The service's own protocol.
pub mod palr_gym {
    /// First version. Field numbers are never reused.
    pub mod v1 {
        tonic::include_proto!("palr_gym.v1");
    }
}

/// DeepMind's public protocol, for clients that already speak it.
pub mod dm_env_rpc {
    /// First version, the only one there is.
    pub mod v1 {
        tonic::include_proto!("dm_env_rpc.v1");
    }
}

/// Public types of Google's API design that our messages name.
pub mod google {
    /// The error model.
    pub mod rpc {
        tonic::include_proto!("google.rpc");
    }
}

pub use palr_gym::v1;
