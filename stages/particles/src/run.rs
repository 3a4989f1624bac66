//! The program around [`crate::settle`]: files, log, checkpoints.
