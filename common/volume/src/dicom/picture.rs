//! Reads the contents of a DICOM file: frames of a scan, a segmentation, or contours.

use super::elements;
use super::header::{Header, damaged, unreadable};
use super::segmentation::Segmentation;
use super::slice::Slice;
use super::structures::Structures;
use crate::error::bad;
use crate::error::{Error, Result};
use dicom_dictionary_std::{tags, uids};
use std::path::{Path, PathBuf};

/// A DICOM file that contains an image or contours.
#[derive(Debug)]
pub(super) struct Picture {
    /// Kind of DICOM object (SOP class UID).
    pub(super) class: String,
    pub(super) series: SeriesName,
    /// The contents, or an error that explains why no volume can be made from them.
    pub(super) content: Result<Content>,
}

/// The contents of a file that form a volume or a part of one.
#[derive(Debug)]
pub(super) enum Content {
    /// Frames of a scan. They may form one volume together with the frames of other files.
    Slices(Vec<Slice>),
    Segmentation(Box<Segmentation>),
    Structures(Box<Structures>),
}

/// Attributes that identify a series.
#[derive(Clone, Debug)]
pub(super) struct SeriesName {
    pub(super) uid: String,
    pub(super) number: String,
    pub(super) description: String,
    pub(super) modality: String,
    /// UID of the frame of reference, which is equal for series in the same coordinates.
    pub(super) frame_of_reference: String,
}

/// The result of reading the header of a DICOM file.
pub(super) enum Found {
    Image(Box<Picture>),
    /// Neither an image nor contours: a report, a directory, or a slice with a truncated header.
    NoImage(Unread),
    /// A damaged or truncated file.
    Unread(Unread),
}

/// A file without a readable image.
pub(super) struct Unread {
    pub(super) path: PathBuf,
    /// SOP class UID and series UID, if they can be read.
    pub(super) class: Option<String>,
    pub(super) series: Option<String>,
    pub(super) error: Error,
}

impl Picture {
    /// Reads the header of a DICOM file.
    ///
    /// # Errors
    /// If the operating system reports an error.
    pub(super) fn read(path: &Path) -> Result<Found> {
        let elements = elements::read(path, false).map_err(|error| unreadable(path, error))?;
        let header = Header { path, object: &elements.object };
        let uid = header.text(tags::SERIES_INSTANCE_UID);
        if let Some(damage) = elements.damage {
            let series = Some(uid).filter(|uid| !uid.is_empty());
            return Ok(Found::Unread(Unread {
                path: path.to_path_buf(),
                class: None,
                series,
                error: damaged(path, &damage),
            }));
        }
        let class = if elements.class.is_empty() { header.text(tags::SOP_CLASS_UID) } else { elements.class };
        let series = SeriesName {
            uid,
            number: header.text(tags::SERIES_NUMBER),
            description: header.text(tags::SERIES_DESCRIPTION),
            modality: header.text(tags::MODALITY),
            frame_of_reference: header.text(tags::FRAME_OF_REFERENCE_UID),
        };
        let content = if class == uids::RT_STRUCTURE_SET_STORAGE {
            Structures::of(&header).map(|all| Content::Structures(Box::new(all)))
        } else {
            let size = header.whole(tags::ROWS).and_then(|rows| Ok((rows, header.whole(tags::COLUMNS)?)));
            match size {
                Err(error) => Err(error),
                Ok((Some(rows), Some(columns))) => content(&header, &class, rows, columns),
                Ok(_) => {
                    return Ok(Found::NoImage(Unread {
                        path: path.to_path_buf(),
                        class: Some(class),
                        series: Some(series.uid).filter(|uid| !uid.is_empty()),
                        error: bad(
                            path,
                            "is of the same kind as the slices, but its header ends before the image",
                            "it is truncated, and the volume would lack a slice",
                            "copy or export the file again",
                        ),
                    }));
                }
            }
        };
        Ok(Found::Image(Box::new(Self { class, series, content })))
    }
}

/// Reads the header of a file with an image.
fn content(header: &Header<'_>, class: &str, rows: usize, columns: usize) -> Result<Content> {
    let frames = Slice::frames(header, rows, columns)?;
    if matches!(class, uids::SEGMENTATION_STORAGE | uids::LABEL_MAP_SEGMENTATION_STORAGE) {
        return Segmentation::of(header, frames).map(|all| Content::Segmentation(Box::new(all)));
    }
    if frames.iter().any(|slice| slice.pixels.bytes == 0) {
        return Err(header.meaningless("BitsAllocated", "1"));
    }
    Ok(Content::Slices(frames))
}
