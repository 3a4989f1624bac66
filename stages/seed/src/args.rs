//! Command-line options of the `seed` program.

use clap::{Parser, ValueEnum};
use isoparticles_stage::cli::{CommonArgs, FILES, METHOD, StageArgs};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Source of the seeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum From {
    /// Random positions at the density that the size field specifies.
    PoissonDisk,
    /// All marching-cubes vertices of the distance field, as in the paper; density control deletes
    /// surplus particles.
    MarchingCubes,
}

/// Places the initial particles on every component of the isosurface F = 0, at approximately the
/// density that the size field specifies
#[derive(Debug, Parser)]
#[command(
    name = "seed",
    version,
    after_help = "Example:\n  seed heart.distfield.vti heart.sizefield.vti -o heart.seeds.bin\n\n\
        Paper: section 3.1 and Eq. 5. The paper seeds as with --from marching-cubes; adding --count gives the seeds of its synthetic test (Table 3)."
)]
pub struct Args {
    /// Distance field, or indicators of several materials, written by distfield
    #[arg(value_name = "F.vti", help_heading = FILES)]
    pub(crate) distfield: PathBuf,
    /// Size field on the same grid, written by sizefield
    #[arg(value_name = "S.vti", help_heading = FILES)]
    pub(crate) sizefield: PathBuf,
    /// Particle file to write
    #[arg(short, long, value_name = "seeds.bin", help_heading = FILES)]
    pub(crate) output: PathBuf,
    /// Source of the seeds (one object only)
    #[arg(long, value_enum, default_value_t = From::PoissonDisk, help_heading = METHOD)]
    pub(crate) from: From,
    /// Number of particles to seed, 4 or more, instead of the number that the size field requires;
    /// approximate, because each component receives some particles. With --from marching-cubes, the
    /// number is exact: evenly spread vertices are used, from a finer grid if there are too few
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(4..), help_heading = METHOD)]
    pub(crate) count: Option<u64>,
    #[command(flatten)]
    common: CommonArgs,
}

impl StageArgs for Args {
    fn common(&self) -> &CommonArgs {
        &self.common
    }

    fn outputs(&self) -> Vec<PathBuf> {
        vec![self.output.clone()]
    }

    fn parameters(&self) -> Value {
        json!({ "from": self.from, "count": self.count })
    }
}
