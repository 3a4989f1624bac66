//! The mesh quality that `--quality` selects. It determines the length scale of `distfield` and the
//! defaults of `sizefield`.

/// Fineness of a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Quality {
    /// About a quarter as many triangles as medium, for a first look.
    Coarse,
    /// As fine as the data supports.
    Medium,
    /// About three times as many triangles as medium, finer than the data supports.
    Fine,
}

impl Quality {
    /// Returns the name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Coarse => "coarse",
            Self::Medium => "medium",
            Self::Fine => "fine",
        }
    }

    /// Returns the minimum h in units of the mean voxel spacing. Triangles with edges shorter than
    /// 0.75 voxels capture no further detail of the data. A minimum of 1.5 gives a quarter as many
    /// triangles as 0.75, and a minimum of 0.5 gives 2.25 times as many.
    #[must_use]
    pub fn smallest_size_voxels(self) -> f64 {
        match self {
            Self::Coarse => 1.5,
            Self::Medium => 0.75,
            Self::Fine => 0.5,
        }
    }
}
