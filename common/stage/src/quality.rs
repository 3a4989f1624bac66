//! The fineness of a mesh in one word. `distfield` chooses its length scale and `sizefield` its
//! defaults by it.

/// Fineness of a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Quality {
    /// About a quarter of the triangles, for a first look.
    Coarse,
    /// As fine as the data supports.
    Medium,
    /// About three times the triangles, smoother than the data.
    Fine,
}

impl Quality {
    /// The name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Coarse => "coarse",
            Self::Medium => "medium",
            Self::Fine => "fine",
        }
    }

    /// Minimum h in mean voxel spacings. Triangles below 0.75 voxels add no information about the
    /// data.
    #[must_use]
    pub fn smallest_size_voxels(self) -> f64 {
        match self {
            Self::Coarse => 1.5,
            Self::Medium => 0.75,
            Self::Fine => 0.5,
        }
    }
}
