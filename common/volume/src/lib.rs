//! Medical volumes: voxels in their original number type, on a grid with a position and orientation
//! in world coordinates.
//!
//! [`read_volume`] reads NRRD, 3D Slicer segmentations, NIfTI, Analyze 7.5, volumes of FreeSurfer,
//! MetaImage, TIFF, NumPy arrays, VTK images and folders of DICOM slices, TIFF slices or masks.
//! Lengths are in mm. Unless stated otherwise, positions are in the *grid frame* (index times
//! spacing, axis-aligned, right-handed). [`Geometry`] converts them to the world frame.
//!
//! [`vtk_xml`] reads and writes VTK XML files of any kind, and [`vti`] reads and writes VTK images.
//! Other crates build their file formats on these two modules.
//!
//! ```
//! use glam::DVec3;
//! use isoparticles_volume::{Geometry, Voxels, nrrd, read_volume};
//!
//! let path =
//!     std::env::temp_dir().join(format!("isoparticles-example-{}.nrrd", std::process::id()));
//! let geometry = Geometry::axis_aligned([2, 2, 2], DVec3::new(0.5, 0.5, 1.5));
//! nrrd::write_nrrd(&path, &geometry, &Voxels::I16((0..8).collect()), nrrd::Encoding::Gzip)?;
//! let volume = read_volume(&path)?;
//! assert_eq!(volume.voxels.range(), Some((0.0, 7.0)));
//! assert_eq!(volume.geometry.grid_to_world(DVec3::new(0.0, 0.0, 1.5)), DVec3::new(0.0, 0.0, 1.5));
//! # std::fs::remove_file(&path).ok();
//! # Ok::<(), isoparticles_volume::Error>(())
//! ```

mod crop;
mod data_files;
mod dicom;
mod error;
mod foreign;
mod geometry;
mod image;
mod layers;
mod limit;
pub mod masks;
mod meta_image;
mod mgh;
mod nifti;
mod npy;
pub mod nrrd;
mod read;
mod segments;
mod shear;
mod tiff;
mod units;
mod volume;
mod voxel_box;
mod voxel_data;
mod voxels;
pub mod vti;
pub mod vtk_xml;

pub use crop::Crop;
pub use data_files::data_files;
pub use error::{Content, Error, Result};
pub use foreign::foreign_content;
pub use geometry::{Geometry, Space};
pub use image::{Image, reverse_slices};
pub use read::{ReadOptions, read_volume, read_volume_with};
pub use segments::{LayerLabel, Segment};
pub use shear::Shear;
pub use volume::Volume;
pub use voxel_box::{CutFaces, VoxelBox};
pub use voxels::{Endian, Pooling, ScalarType, Voxels};
pub use vti::write_volume;
