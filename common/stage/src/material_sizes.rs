//! The option `--size`, which sets an edge length for a material or an interface by name.

use crate::error::{Error, Result};
use isoparticles_field::materials::{MaterialId, Stratum};
use serde::{Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// An edge length for a material or an interface.
#[derive(Clone, Debug, PartialEq)]
pub struct GivenSize {
    /// Name of a material, or names of two materials separated by a slash.
    name: String,
    /// Edge length, mm.
    size: f64,
}

impl FromStr for GivenSize {
    type Err = String;

    /// Parses `NAME=H` or `NAME/NAME=H`.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let form = || "write it as NAME=H or NAME/NAME=H (mm)".to_owned();
        let (name, size) = text.rsplit_once('=').filter(|(name, _)| !name.is_empty()).ok_or_else(form)?;
        let size = size.trim().parse::<f64>().ok().filter(|size| size.is_finite()).ok_or_else(form)?;
        if size <= 0.0 {
            return Err("h must be above 0".to_owned());
        }
        Ok(Self { name: name.to_owned(), size })
    }
}

impl fmt::Display for GivenSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.name, self.size)
    }
}

impl Serialize for GivenSize {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The user's edge lengths for materials and interfaces.
#[derive(Clone, Debug, Default)]
pub struct Given {
    materials: Vec<(MaterialId, f64)>,
    interfaces: Vec<(Stratum, f64)>,
}

impl Given {
    /// Looks up the names in `sizes`. `names` contains the name of each material, indexed by
    /// material number.
    ///
    /// # Errors
    /// If a name is unknown.
    pub fn new(sizes: &[GivenSize], names: &[String]) -> Result<Self> {
        let mut given = Self::default();
        let named = |name: &str| names.iter().position(|other| other == name).map(|n| MaterialId(n as u16));
        for own in sizes {
            let unknown = || {
                Error::input(
                    format!("--size {own}: no such material or interface"),
                    "the edge length would have no effect",
                    format!("use one of these materials, or two of them separated by a slash: {}", names.join(", ")),
                )
            };
            if let Some(id) = named(&own.name) {
                given.materials.push((id, own.size));
                continue;
            }
            let pairs = own.name.match_indices('/').map(|(at, _)| (&own.name[..at], &own.name[at + 1..]));
            let pair = pairs.filter_map(|(a, b)| named(a).zip(named(b))).find(|(a, b)| a != b);
            let (a, b) = pair.ok_or_else(unknown)?;
            given.interfaces.push((Stratum::interface(a, b), own.size));
        }
        Ok(given)
    }

    /// Returns the largest edge length in mm that is set for any material.
    pub fn largest(&self) -> Option<f64> {
        self.materials.iter().map(|(_, size)| *size).max_by(f64::total_cmp)
    }

    /// Returns the edge length in mm that is set for a material. If several lengths are set,
    /// returns the smallest. Ignores lengths that are set for interfaces.
    pub fn of_material(&self, id: MaterialId) -> Option<f64> {
        self.materials.iter().filter(|(own, _)| *own == id).map(|(_, size)| *size).min_by(f64::total_cmp)
    }

    /// Returns the edge length in mm of an interface. If no length is set for the interface,
    /// returns the smallest length that is set for its two materials.
    pub fn of(&self, interface: &Stratum) -> Option<f64> {
        let smallest = |sizes: &mut dyn Iterator<Item = f64>| sizes.min_by(f64::total_cmp);
        let own = smallest(&mut self.interfaces.iter().filter(|(other, _)| other == interface).map(|(_, size)| *size));
        own.or_else(|| smallest(&mut self.materials.iter().filter(|(id, _)| interface.has(*id)).map(|(_, size)| *size)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_and_wrong_ones_told() {
        let read: GivenSize = "left/right lung=1.5".parse().expect("a size");
        assert_eq!(
            (read.name.as_str(), read.size, read.to_string().as_str()),
            ("left/right lung", 1.5, "left/right lung=1.5")
        );
        for wrong in ["lung", "=2", "lung=", "lung=-1", "lung=0", "lung=NaN"] {
            assert!(wrong.parse::<GivenSize>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn pairs_override_materials_and_smaller_sizes_win() {
        let [a, b, c] = [1, 2, 3].map(MaterialId);
        let given = Given { materials: vec![(a, 2.0), (b, 1.0)], interfaces: vec![(Stratum::interface(a, b), 3.0)] };
        assert_eq!(given.of(&Stratum::interface(b, a)), Some(3.0));
        assert_eq!(given.of(&Stratum::interface(a, c)), Some(2.0));
        assert_eq!(given.of(&Stratum::interface(MaterialId::OUTSIDE, c)), None);
        assert_eq!([a, b, c].map(|id| given.of_material(id)), [Some(2.0), Some(1.0), None]);
    }
}
