//! The world frame of the output: the option `--space`, and the frame of the volume's file in the
//! history.

use crate::error::{Error, Result};
use isoparticles_file::history::History;
use isoparticles_volume::{Geometry, Space};
use serde_json::{Value, json};

/// Parameter of `distfield` that contains the frame of the volume's file.
pub const FILE_SPACE: &str = "file_space";

/// A world frame that the user can choose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SpaceChoice {
    /// Left, posterior, superior, as in DICOM and ITK.
    #[default]
    Lps,
    /// Right, anterior, superior, as in NIfTI and FreeSurfer.
    Ras,
    /// The frame of the volume's file.
    Scanner,
}

impl SpaceChoice {
    /// Returns a grid in the chosen frame. `file` is the frame of the volume's file. If it is
    /// unknown, as in files written by older versions, LPS is assumed.
    ///
    /// # Errors
    /// If RAS is chosen and the grid has no anatomical frame.
    pub fn of(self, geometry: Geometry, file: Option<Space>) -> Result<Geometry> {
        let space = match self {
            Self::Ras if geometry.space == Space::Unnamed => {
                return Err(Error::input(
                    "--space ras: the input names no anatomical space",
                    "its coordinates do not define left and right",
                    "omit --space (SPACE=) to keep its coordinates, or convert the volume to NIfTI or NRRD with a space",
                ));
            }
            Self::Ras => Space::Ras,
            Self::Lps => Space::Lps,
            Self::Scanner => file.filter(|space| space.name().is_some()).unwrap_or(Space::Lps),
        };
        Ok(geometry.in_space(space))
    }
}

/// Returns a frame as a parameter: `lps`, `ras`, or null if it is not anatomical.
pub fn parameter(space: Space) -> Value {
    json!(space.name().map(str::to_lowercase))
}

/// Returns the frame of the volume's file from the parameters of `distfield` in a history or in
/// those of its inputs.
pub fn file_space(history: &History) -> Option<Space> {
    match history.parameters[FILE_SPACE].as_str() {
        Some("lps") => Some(Space::Lps),
        Some("ras") => Some(Space::Ras),
        _ => history.inputs.iter().filter_map(|input| input.history.as_deref()).find_map(file_space),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_file::history::Input;

    fn history(parameters: Value, inputs: Vec<Input>) -> History {
        let text = String::new;
        History { tool: text(), version: text(), command_line: text(), parameters, inputs }
    }

    #[test]
    fn the_frame_of_the_file_is_found_behind_later_stages() {
        let first = history(json!({ FILE_SPACE: parameter(Space::Ras) }), Vec::new());
        let input = |history| Input { path: String::new(), blake3: String::new(), history };
        let later = history(json!({}), vec![input(None), input(Some(Box::new(first)))]);
        assert_eq!(file_space(&later), Some(Space::Ras));
        assert_eq!(file_space(&history(json!({ FILE_SPACE: null }), Vec::new())), None);
    }

    #[test]
    fn only_a_grid_with_an_anatomical_space_has_ras() {
        let unnamed = Geometry::axis_aligned([2; 3], DVec3::ONE);
        let lps = Geometry { space: Space::Lps, origin: DVec3::new(1.0, 2.0, 3.0), ..unnamed.clone() };
        let space = |choice: SpaceChoice, file| choice.of(lps.clone(), file).expect("anatomical");
        let ras = space(SpaceChoice::Ras, None);
        assert_eq!((ras.space, ras.origin), (Space::Ras, DVec3::new(-1.0, -2.0, 3.0)));
        assert_eq!(ras.directions.x_axis, DVec3::NEG_X);
        assert_eq!(space(SpaceChoice::Scanner, Some(Space::Ras)), ras);
        assert_eq!(space(SpaceChoice::Scanner, None), lps, "a file of an older version");
        assert_eq!(SpaceChoice::Lps.of(ras.clone(), None).expect("anatomical"), lps, "and back");
        for choice in [SpaceChoice::Lps, SpaceChoice::Scanner] {
            assert_eq!(choice.of(unnamed.clone(), Some(Space::Unnamed)).expect("unchanged"), unnamed);
        }
        let error = SpaceChoice::Ras.of(unnamed, None).expect_err("without left and right");
        assert!(error.why.contains("left and right"), "{error}");
    }
}
