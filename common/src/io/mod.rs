//! Files: each format in one module, all of them checked before memory is taken.
//!
//! Volumes come in through [`volume::read_volume`] and point clouds through [`point_cloud::read_point_cloud`]; fields,
//! particles and surfaces go between the stages through [`field`], [`particles`] and [`surface`]; [`output`] writes every
//! file whole or not at all.

mod data_files;
mod dicom;
pub mod field;
mod limit;
mod meta_image;
mod nifti;
pub mod nrrd;
pub mod output;
pub mod particles;
pub mod point_cloud;
pub mod points;
pub mod surface;
pub mod volume;
mod voxel_data;
mod vti;
mod vtk_xml;

pub use data_files::data_files;
