//! Tests that cross a process, a transport or a crate; see `it/`. Python tests stand in `python/`.
