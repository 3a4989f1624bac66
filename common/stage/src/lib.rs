//! Shared parts of the stage programs of isoparticles.
//!
//! [`cli`] contains the common options, exit codes, progress and report. [`error`] contains the
//! user-facing errors in three parts. [`field_file`], [`materials_file`], [`distance_field`] and
//! [`particle_file`] read and write the files that stages exchange, and [`meta`] defines the
//! metadata in these files. [`space`] contains the choice of the world frame.
//!
//! ```no_run
//! use isoparticles_stage::cli::{CommonArgs, Context, Outcome, StageArgs, run_stage};
//! use isoparticles_stage::error::Result;
//! use std::path::PathBuf;
//!
//! #[derive(clap::Parser)]
//! struct Args {
//!     input: PathBuf,
//!     #[command(flatten)]
//!     common: CommonArgs,
//! }
//!
//! impl StageArgs for Args {
//!     fn common(&self) -> &CommonArgs {
//!         &self.common
//!     }
//!     fn outputs(&self) -> Vec<PathBuf> {
//!         Vec::new()
//!     }
//!     fn parameters(&self) -> serde_json::Value {
//!         serde_json::json!({})
//!     }
//! }
//!
//! fn run(args: &Args, context: &Context) -> Result<Outcome> {
//!     context.add_input(&args.input, None)?;
//!     Ok(Outcome::Passed)
//! }
//!
//! fn main() -> std::process::ExitCode {
//!     run_stage::<Args>("trial", run)
//! }
//! ```

pub mod cli;
pub mod distance_field;
pub mod error;
pub mod field_file;
pub mod material_sizes;
pub mod materials_file;
pub mod meta;
pub mod output;
pub mod particle_file;
pub mod quality;
pub mod space;

pub use isoparticles_file::{history, limit, monitor};
