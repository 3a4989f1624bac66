//! How fine a mesh is asked for, in one word: what `distfield` chooses its scale by and `sizefield` its defaults.

/// How fine a mesh is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Quality {
    /// About a quarter of the triangles: a first look.
    Coarse,
    /// What the data can carry.
    Medium,
    /// About three times the triangles: smoother than the data.
    Fine,
}

impl Quality {
    /// As on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Coarse => "coarse",
            Self::Medium => "medium",
            Self::Fine => "fine",
        }
    }

    /// Smallest h over the mean voxel spacing: finer triangles than 0.75 of it say nothing about the data.
    #[must_use]
    pub fn smallest_size_voxels(self) -> f64 {
        match self {
            Self::Coarse => 1.5,
            Self::Medium => 0.75,
            Self::Fine => 0.5,
        }
    }
}
