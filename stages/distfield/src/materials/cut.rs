//! Planes that cut materials (`--cut`).

use super::grid::LabelGrid;
use super::survey::{Survey, survey};
use glam::DVec3;
use isoparticles_field::materials::{Bound, MaterialId, Materials};
use isoparticles_stage::error::{Error, Result as StageResult};
use isoparticles_stage::monitor::Monitor;
use std::str::FromStr;

/// A plane that cuts materials. The materials on the side to which the normal points are removed.
#[derive(Clone, Debug, PartialEq)]
pub struct Cut {
    /// A point of the plane in the world frame of the output, mm.
    point: DVec3,
    /// Normal of the plane in this frame, of any length.
    normal: DVec3,
    /// Name of the triangles in the plane.
    name: Option<String>,
    /// The option as given.
    text: String,
}

impl FromStr for Cut {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (shape, name) = text.split_once('=').map_or((text, None), |(shape, name)| (shape, Some(name.trim())));
        let numbers = shape.trim().strip_prefix("plane:").unwrap_or_default().split(',');
        let numbers: Result<Vec<f64>, _> = numbers.map(|number| number.trim().parse()).collect();
        let Ok(&[x, y, z, u, v, w]) = numbers.as_deref() else {
            return Err("write plane:X,Y,Z,NX,NY,NZ or plane:X,Y,Z,NX,NY,NZ=NAME".to_owned());
        };
        let (point, normal) = (DVec3::new(x, y, z), DVec3::new(u, v, w));
        if !point.is_finite() || normal.try_normalize().is_none() {
            return Err("the six numbers must be finite, and the normal NX,NY,NZ must not be zero".to_owned());
        }
        if name == Some("") {
            return Err("the name after '=' is empty".to_owned());
        }
        Ok(Self { point, normal, name: name.map(str::to_owned), text: text.to_owned() })
    }
}

impl std::fmt::Display for Cut {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}

/// Ends materials at planes: those of `--cut`, then those at the border of the volume. A plane of
/// `--cut` without a name is named `cutN`, where N is its number from 1.
///
/// # Errors
/// If the name of a plane is that of a material or of another plane, ignoring case.
pub(super) fn with_planes(materials: Materials, cuts: &[Cut], at_border: Vec<Bound>) -> StageResult<Materials> {
    let geometry = materials.geometry();
    let bound = |(n, cut): (usize, &Cut)| {
        let point = geometry.world_to_grid(cut.point);
        let normal = geometry.world_to_grid(cut.point + cut.normal.normalize()) - point;
        let name = cut.name.clone().unwrap_or_else(|| format!("cut{}", n + 1));
        Bound { name, point, normal: normal.normalize() }
    };
    let bounds: Vec<Bound> = cuts.iter().enumerate().map(bound).chain(at_border).collect();
    let mut taken = materials.names();
    for (n, bound) in bounds.iter().enumerate() {
        if taken.iter().any(|other| other.eq_ignore_ascii_case(&bound.name)) {
            let option = cuts.get(n).map_or_else(|| "--border flat".to_owned(), |cut| format!("--cut {cut}"));
            return Err(Error::input(
                format!("{option}: the name '{}' is taken", bound.name),
                "materials, planes and faces of the volume (x0, x1, y0, ...) must have different names",
                "rename the plane (--cut plane:X,Y,Z,NX,NY,NZ=NAME) or the material (MATERIALS, --material)",
            ));
        }
        taken.push(bound.name.clone());
    }
    Ok(materials.with_bounds(bounds))
}

/// Surveys materials that end at planes. Checks that each plane of `cuts` cuts a material, and that
/// no material lies beyond the planes.
///
/// # Errors
/// If a check fails, or the run is interrupted.
pub(super) fn survey_cut(
    materials: &Materials,
    grid: &LabelGrid,
    cuts: &[Cut],
    monitor: &dyn Monitor,
) -> StageResult<Survey> {
    let count = materials.table().len();
    let found = survey(materials, materials.geometry(), grid, count, materials.bounds(), monitor)?;
    let is_cut = |bound: usize| {
        let beyond = MaterialId((materials.indicators().len() + bound) as u16);
        found.interfaces.iter().any(|pair| pair.materials[1] == beyond && pair.materials[0] != MaterialId::OUTSIDE)
    };
    if let Some((_, cut)) = cuts.iter().enumerate().find(|(n, _)| !is_cut(*n)) {
        return Err(Error::input(
            format!("--cut {cut}: the plane meets no material"),
            "it would cut nothing",
            "check the position (mm, world frame of the output); isoparticles info prints the bounding box of each label",
        ));
    }
    let is_gone = |id: &usize| !cuts.is_empty() && found.volumes[*id] <= 0.0;
    match (1..materials.indicators().len()).find(is_gone) {
        Some(gone) => Err(Error::input(
            format!("--cut: the planes remove the whole material '{}'", materials.table()[gone].name),
            "a material without volume cannot be meshed",
            "reverse the normal, move the plane, or leave the material out of MATERIALS (--material)",
        )),
        None => Ok(found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::materials::{Indicator, Material};
    use isoparticles_volume::Geometry;

    #[test]
    fn cuts_are_read_with_and_without_a_name() {
        let cut: Cut = "plane:1, 2,-3,0,0,2=inlet".parse().expect("a plane");
        assert_eq!((cut.point, cut.name.as_deref()), (DVec3::new(1.0, 2.0, -3.0), Some("inlet")));
        assert_eq!("plane:0,0,0,1,0,0".parse::<Cut>().map(|cut| cut.name), Ok(None));
        for wrong in [
            "",
            "plane:1,2,3",
            "ball:1,2,3,4,5,6",
            "plane:0,0,0,0,0,0",
            "plane:a,0,0,1,0,0",
            "plane:1,2,x,3,4,5,6",
            "plane:0,0,0,1,0,0=",
        ] {
            assert!(wrong.parse::<Cut>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn planes_are_converted_to_the_grid_and_need_unique_names() {
        let mut geometry = Geometry::axis_aligned([10; 3], DVec3::splat(0.5));
        geometry.origin = DVec3::new(3.0, 0.0, 0.0);
        let outside =
            (Material { name: "outside".to_owned(), labels: Vec::new() }, Indicator::constant(true), Vec::new());
        let materials = Materials::new(geometry, vec![outside]).expect("one material");
        let cuts = ["plane:4,0,0,2,0,0", "plane:0,0,0,0,0,1=top"].map(|text| text.parse::<Cut>().expect("a plane"));
        let made = with_planes(materials.clone(), &cuts, Vec::new()).expect("two names");
        assert_eq!(made.names(), ["outside", "cut1", "top"]);
        let bound = &made.bounds()[0];
        assert!(bound.distance(DVec3::X).abs() < 1e-12 && bound.normal.distance(DVec3::X) < 1e-12);
        let face = Bound { name: "Top".to_owned(), ..bound.clone() };
        assert!(with_planes(materials, &cuts, vec![face]).is_err());
    }
}
