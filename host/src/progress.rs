//! How long work tells how far it is, without knowing who listens.

/// Listener of a long computation. Calls may come from several threads.
pub trait Progress: Sync {
    /// Begins a stage of `steps` equal steps; the stage before it has ended.
    fn begin(&self, stage: &str, steps: u64);
    /// One step of the stage is done.
    fn step(&self);
}

/// Listens to nothing.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &str, _steps: u64) {}
    fn step(&self) {}
}
