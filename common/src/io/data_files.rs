//! Which other files a volume's header names, so that a change of one of them is a change of the volume.

use super::nrrd;
use crate::error::{Error, Result};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Longest MetaImage header that is looked at.
const MOST_HEADER_BYTES: u64 = 1 << 20;

/// The files that hold the voxels of a detached NRRD or MetaImage header, in order; none for any other file.
///
/// # Errors
/// When the header cannot be read.
pub fn data_files(path: &Path) -> Result<Vec<PathBuf>> {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let names = match extension.as_deref() {
        Some("nhdr" | "nrrd") => nrrd::named_files(path)?,
        Some("mhd" | "mha") => meta_image_files(path)?,
        _ => Vec::new(),
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    Ok(names.iter().map(|name| folder.join(name)).collect())
}

/// What `ElementDataFile`, the last line of a MetaImage header, names: one file, a list, or a pattern with its range.
fn meta_image_files(path: &Path) -> Result<Vec<String>> {
    let unreadable = |error: std::io::Error| Error::file(path, "read", &error, "check the name of the volume");
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(unreadable)?;
    file.take(MOST_HEADER_BYTES).read_to_end(&mut bytes).map_err(unreadable)?;
    let text = String::from_utf8_lossy(&bytes);
    let mut lines = text.lines().map(str::trim);
    let value = lines.by_ref().find_map(|line| {
        let (key, value) = line.split_once('=')?;
        key.trim().eq_ignore_ascii_case("ElementDataFile").then(|| value.trim())
    });
    let words: Vec<&str> = value.unwrap_or_default().split_whitespace().collect();
    Ok(match (value.unwrap_or_default(), words.as_slice()) {
        ("" | "LOCAL" | "local" | "Local", _) => Vec::new(),
        (_, ["LIST", ..]) => lines.filter(|line| !line.is_empty()).map(str::to_owned).collect(),
        (_, [pattern, range @ ..]) if pattern.contains('%') && range.len() >= 2 => from_pattern(pattern, range),
        (name, _) => vec![name.to_owned()],
    })
}

/// `slice%03d.raw 1 80 1`: one file a number. What is no pattern of that kind names nothing.
fn from_pattern(pattern: &str, range: &[&str]) -> Vec<String> {
    let numbers: Vec<u32> = range.iter().map_while(|word| word.parse().ok()).collect();
    let (Some((before, rest)), [first, last, step @ ..]) = (pattern.split_once('%'), numbers.as_slice()) else {
        return Vec::new();
    };
    let Some((width, after)) = rest.split_once('d') else { return Vec::new() };
    let (zeros, width) = (width.starts_with('0'), width.parse().unwrap_or(0));
    let step = step.first().copied().unwrap_or(1).max(1) as usize;
    let file = |number: u32| match zeros {
        true => format!("{before}{number:0width$}{after}"),
        false => format!("{before}{number:width$}{after}"),
    };
    (*first..=*last).step_by(step).map(file).collect()
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
        let meta = "ObjectType = Image\nNDims = 3\nElementDataFile = ";
        assert_eq!(files("a.mha", &format!("{meta}LOCAL\n\u{1}\u{2}")), [] as [&str; 0]);
        assert_eq!(files("a.mhd", &format!("{meta}my voxels.raw\n")), ["my voxels.raw"]);
        assert_eq!(files("b.mhd", &format!("{meta}LIST\none.raw\ntwo.raw\n")), ["one.raw", "two.raw"]);
        assert_eq!(files("c.mhd", &format!("{meta}s%02d.raw 8 12 2\n")), ["s08.raw", "s10.raw", "s12.raw"]);
        assert_eq!(files("a.nii", "no header of these"), [] as [&str; 0]);
    }
}
