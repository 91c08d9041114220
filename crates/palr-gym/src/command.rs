//! One file a command.

pub mod bench;
pub mod collect;
pub mod completions;
pub mod data;
pub mod demo;
pub mod envs;
pub mod evaluate;
pub mod expert;
pub mod leakage;
pub mod render;
pub mod runs;
pub mod serve;
pub mod train;
