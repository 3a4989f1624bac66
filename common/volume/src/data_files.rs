//! Lists the additional files of a volume, such as separate voxel files, so that callers can check
//! them for changes.

use crate::error::{Error, Result};
use crate::voxel_data::DataFiles;
use crate::{dicom, meta_image, nifti, nrrd};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

/// Returns the additional files of a volume. For a detached NRRD or MetaImage header, the list
/// contains the voxel files, in order. For one file of a NIfTI pair, it contains the other file.
/// For DICOM contours, it contains the other DICOM files in the folder. For any other file, it is
/// empty.
///
/// # Errors
/// If the header cannot be read.
pub fn data_files(path: &Path) -> Result<Vec<PathBuf>> {
    if let Some(other) = nifti::partner(path) {
        return Ok(vec![other]);
    }
    let unreadable = |error: std::io::Error| Error::file(path, "read", error, "check the name of the volume");
    let mut reader = BufReader::new(File::open(path).map_err(unreadable)?);
    let start = reader.fill_buf().map_err(unreadable)?;
    let files = if start.starts_with(b"NRRD000") {
        nrrd::data_files(path, &mut reader)?
    } else if meta_image::is_meta_image(start) {
        meta_image::data_files(path, &mut reader)?
    } else if dicom::is_dicom(start) {
        return dicom::data_files(path);
    } else {
        DataFiles::Attached
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    Ok(match files {
        DataFiles::Attached => Vec::new(),
        DataFiles::Named(names) => names.iter().map(|name| folder.join(name)).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_files_of_detached_headers_are_found() {
        let folder = tempfile::tempdir().expect("folder");
        let files = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).expect("written");
            let names = data_files(&path).expect("read");
            let names =
                names.iter().map(|path| path.strip_prefix(folder.path()).expect("beside the header").to_owned());
            names.map(|path| path.to_string_lossy().into_owned()).collect::<Vec<_>>()
        };
        let nrrd = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n";
        assert_eq!(files("a.nrrd", &format!("{nrrd}\n12345678")), [] as [&str; 0]);
        assert_eq!(files("a.nhdr", &format!("{nrrd}data file: my voxels.raw\n")), ["my voxels.raw"]);
        assert_eq!(files("b.nhdr", &format!("{nrrd}data file: LIST\none.raw\ntwo.raw\n")), ["one.raw", "two.raw"]);
        let meta = "ObjectType = Image\nNDims = 3\nDimSize = 2 2 3\nElementType = MET_UCHAR\nElementDataFile = ";
        assert_eq!(files("a.mha", &format!("{meta}LOCAL\n\u{1}\u{2}")), [] as [&str; 0]);
        assert_eq!(files("a.mhd", &format!("{meta}my voxels.raw\n")), ["my voxels.raw"]);
        assert_eq!(files("c.mhd", &format!("{meta}s%02d.raw 8 12 2\n")), ["s08.raw", "s10.raw", "s12.raw"]);
        assert_eq!(files("a.nii", "no header of these"), [] as [&str; 0]);
    }
}
