//! Regions in which the user sets h (`--refine`, `--resize`): balls, the nonzero voxels of a mask
//! volume, or points with sizes (section 7 of the paper: more particles in regions of interest).

use glam::DVec3;
use isoparticles_mesh::points::read_sized_points;
use isoparticles_stage::cli::Context;
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::{Geometry, read_volume};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// A region with its h, as given by the user. For `--refine`, the sizes are upper bounds of h; for
/// `--resize`, they replace h.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// A ball.
    Ball(Ball),
    /// The nonzero voxels of a volume.
    Mask {
        /// The volume, placed by its world coordinates. Its grid may differ from the grid of F.
        file: PathBuf,
        /// h in the region, mm.
        size: f64,
    },
    /// Points with an array `h` that contains h in mm around each point.
    Points {
        /// The file (.vtp or .vtu), in world coordinates.
        file: PathBuf,
    },
}

/// A ball.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ball {
    /// Centre in world coordinates of F, mm.
    pub centre: DVec3,
    /// Radius, mm.
    pub radius: f64,
    /// h in the region, mm.
    pub size: f64,
}

/// A node of the grid, and h in mm at the node.
pub type SizedNode = (usize, f64);

const FORMS: &str = "write it as ball:X,Y,Z,RADIUS=H (mm), mask:FILE=H (mm) or points:FILE";

impl FromStr for Region {
    type Err = String;

    /// Parses `ball:X,Y,Z,RADIUS=H`, `mask:FILE=H` or `points:FILE`.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let form = || FORMS.to_owned();
        let number = |t: &str| t.trim().parse::<f64>().ok().filter(|x| x.is_finite()).ok_or_else(form);
        let (kind, rest) = text.split_once(':').ok_or_else(form)?;
        if kind == "points" && !rest.is_empty() {
            return Ok(Self::Points { file: rest.into() });
        }
        let (place, size) = rest.rsplit_once('=').filter(|(place, _)| !place.is_empty()).ok_or_else(form)?;
        let size = number(size)?;
        let above_zero = |x: f64| if x > 0.0 { Ok(x) } else { Err("radius and h must be above 0".to_owned()) };
        match kind {
            "ball" => {
                let place: Vec<f64> = place.split(',').map(number).collect::<std::result::Result<_, _>>()?;
                let &[x, y, z, radius] = place.as_slice() else { return Err(form()) };
                let (radius, size) = (above_zero(radius)?, above_zero(size)?);
                Ok(Self::Ball(Ball { centre: DVec3::new(x, y, z), radius, size }))
            }
            "mask" => Ok(Self::Mask { file: place.into(), size: above_zero(size)? }),
            _ => Err(form()),
        }
    }
}

impl Region {
    /// Returns the file of the region, if there is one.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::Ball(_) => None,
            Self::Mask { file, .. } | Self::Points { file } => Some(file),
        }
    }

    /// Returns the grid nodes in the region.
    ///
    /// # Errors
    /// If the file of the region cannot be read, or if the region lies outside the grid.
    pub fn nodes(&self, geometry: &Geometry) -> Result<Vec<SizedNode>> {
        let nodes = match self {
            Self::Ball(ball) => ball.nodes(geometry).map(|node| (node, ball.size)).collect(),
            Self::Mask { file, size } => mask_nodes(file, geometry)?.into_iter().map(|node| (node, *size)).collect(),
            Self::Points { file } => {
                let (points, space) = read_sized_points(file, "h")?;
                let signs = space.signs_to(geometry.space);
                let around = |&(p, size): &(DVec3, f64)| {
                    nodes_around(geometry, geometry.world_to_grid(p * signs)).map(move |node| (node, size))
                };
                points.iter().flat_map(around).collect::<Vec<SizedNode>>()
            }
        };
        if nodes.is_empty() {
            let what = match self {
                Self::Ball(Ball { centre: DVec3 { x, y, z }, radius, .. }) => {
                    format!("the ball of radius {radius} mm at ({x}, {y}, {z}) mm is")
                }
                Self::Mask { file, .. } => format!("{}: has no nonzero voxels, or all of them are", file.display()),
                Self::Points { file } => format!("{}: has no points, or all of them are", file.display()),
            };
            return Err(Error::input(
                format!("{what} outside the grid of F"),
                "it would have no effect",
                format!(
                    "use world coordinates in mm, as in the meshes{}: the grid covers {}; \
                     DISTFIELD_OPTIONS=\"--grid volume\" computes F on the whole volume",
                    geometry.space.name().map_or_else(String::new, |name| format!(" ({name})")),
                    extent_told(geometry)
                ),
            ));
        }
        Ok(nodes)
    }
}

/// Returns the extent of a grid in world coordinates, as text.
fn extent_told(geometry: &Geometry) -> String {
    let [low, high] = geometry.world_box([DVec3::ZERO, geometry.upper_corner()]);
    let range = |a: usize| format!("{} {} to {}", ["x", "y", "z"][a], significant(low[a]), significant(high[a]));
    format!("{} mm", [0, 1, 2].map(range).join(", "))
}

/// Returns the nodes whose nearest voxel is not zero in a layer of the mask, and the nodes around
/// the centres of all nonzero voxels. The latter are needed because mask voxels may be smaller than
/// the cells of the grid.
fn mask_nodes(file: &Path, geometry: &Geometry) -> Result<Vec<usize>> {
    let volume = read_volume(file)?;
    let place = volume.geometry.clone().in_space(geometry.space);
    if place.space != geometry.space {
        return Err(Error::input(
            format!("{}: is not in the same space as F", file.display()),
            "one of them specifies an anatomical space and the other does not, so their positions cannot be compared",
            "write the mask in the frame of the volume, or give balls",
        ));
    }
    let mut mask = vec![false; volume.voxels.len()];
    for layer in volume.layers() {
        let values = layer.to_f32();
        mask.par_iter_mut().zip(values).for_each(|(set, value)| *set |= value != 0.0 && value.is_finite());
    }
    let mut nodes: Vec<usize> = (0..geometry.voxel_count())
        .into_par_iter()
        .filter(|&n| {
            let index =
                place.grid_to_index(place.world_to_grid(geometry.grid_to_world(geometry.node_to_grid(n)))).round();
            let is_within = (0..3).all(|a| index[a] >= 0.0 && index[a] < place.size[a] as f64);
            is_within && mask[place.linear(index.x as usize, index.y as usize, index.z as usize)]
        })
        .collect();
    let own: Vec<usize> = (0..mask.len())
        .into_par_iter()
        .filter(|&n| mask[n])
        .flat_map_iter(|n| nodes_around(geometry, geometry.world_to_grid(place.grid_to_world(place.node_to_grid(n)))))
        .collect();
    nodes.extend(own);
    nodes.par_sort_unstable();
    nodes.dedup();
    Ok(nodes)
}

/// Returns the nodes of the cell that contains a position in the grid frame, or no nodes if the
/// position lies outside the grid.
fn nodes_around(geometry: &Geometry, grid: DVec3) -> impl Iterator<Item = usize> {
    let index = geometry.grid_to_index(grid);
    let is_within = (0..3).all(|a| index[a] >= 0.0 && index[a] <= (geometry.size[a] - 1) as f64);
    let (size, geometry) = (geometry.size, geometry.clone());
    (0..if is_within { 8 } else { 0 }).map(move |corner: usize| {
        let at: [usize; 3] = std::array::from_fn(|a| (index[a] as usize + (corner >> a & 1)).min(size[a] - 1));
        geometry.linear(at[0], at[1], at[2])
    })
}

impl Ball {
    /// Returns the grid nodes in the ball, or within a cell diagonal of its centre if the radius is
    /// smaller. Returns no nodes if the ball lies outside the grid.
    pub fn nodes<'a>(&self, geometry: &'a Geometry) -> impl Iterator<Item = usize> + 'a {
        let centre = geometry.world_to_grid(self.centre);
        let reach = self.radius.max(geometry.spacing.length());
        let low = geometry.grid_to_index(centre - reach).ceil();
        let high = geometry.grid_to_index(centre + reach).floor();
        // both ends are clamped to 0, so the range is empty for a ball that lies before the first
        // node
        let range = move |a: usize| low[a].max(0.0) as usize..((high[a] + 1.0).max(0.0) as usize).min(geometry.size[a]);
        let along = move |j, k| range(0).map(move |i| [i, j, k]);
        let grid = range(2).flat_map(move |k| range(1).flat_map(move |j| along(j, k)));
        grid.filter(move |at| {
            let node = geometry.index_to_grid(DVec3::from_array(at.map(|n| n as f64)));
            node.distance(centre) <= reach
        })
        .map(|[i, j, k]| geometry.linear(i, j, k))
    }
}

/// Returns the nodes of a region, and adds its file to the inputs.
pub(crate) fn sized_nodes(region: &Region, geometry: &Geometry, context: &Context) -> Result<Vec<SizedNode>> {
    let nodes = region.nodes(geometry)?;
    if let Some(file) = region.file() {
        context.add_input(file, None)?;
        context.info(format!("{}: {} grid nodes", file.display(), nodes.len()));
    }
    Ok(nodes)
}

/// Returns the nodes of all `--refine` regions, and adds their files to the inputs.
pub(crate) fn refined_nodes(regions: &[Region], geometry: &Geometry, context: &Context) -> Result<Vec<SizedNode>> {
    let nodes = regions.iter().map(|region| sized_nodes(region, geometry, context));
    Ok(nodes.collect::<Result<Vec<_>>>()?.concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_mesh::TriangleMesh;
    use isoparticles_mesh::surface::{DataArray, Surface, write_surface};
    use isoparticles_stage::field_file::{Field, FieldKind};
    use isoparticles_volume::{Image, Space, Volume, Voxels, write_volume};

    #[test]
    fn text_is_read_or_refused_with_the_form() {
        let ball: Region = "ball:1,-2.5, 3,4=0.5".parse().unwrap();
        assert_eq!(ball, Region::Ball(Ball { centre: DVec3::new(1.0, -2.5, 3.0), radius: 4.0, size: 0.5 }));
        let mask: Region = "mask:a=b:c.nrrd=0.5".parse().unwrap();
        assert_eq!(mask, Region::Mask { file: "a=b:c.nrrd".into(), size: 0.5 });
        let points: Region = "points:p=1.vtp".parse().unwrap();
        assert_eq!(points, Region::Points { file: "p=1.vtp".into() });
        let wrongs = ["", "ball:1,2,3=1", "ball:1,2,3,4", "box:1,2,3,4=1", "ball:1,2,x,4=1", "ball:1,2,3,inf=1"];
        for wrong in wrongs.into_iter().chain(["points:", "mask:a.nrrd", "mask:=1", "mask:a.nrrd=NaN"]) {
            assert!(wrong.parse::<Region>().unwrap_err().contains("ball:X,Y,Z,RADIUS=H"), "{wrong}");
        }
        for wrong in ["ball:1,2,3,0=1", "ball:1,2,3,4=-1", "mask:a.nrrd=0"] {
            assert!(wrong.parse::<Region>().unwrap_err().contains("above 0"), "{wrong}");
        }
    }

    #[test]
    fn masks_count_in_all_layers_and_in_the_same_space_only() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("mask.vti");
        let voxels = |set: usize| Voxels::U8((0..27).map(|n| u8::from(n == set)).collect());
        let mut volume = Volume::new(Geometry::axis_aligned([3, 3, 3], DVec3::ONE), voxels(0));
        volume.more_layers.push(voxels(26));
        write_volume(&file, &volume, &Context::silent("distfield").history()).unwrap();
        let mask = Region::Mask { file, size: 0.5 };
        let nodes = mask.nodes(&volume.geometry).unwrap();
        assert!(nodes.contains(&(0, 0.5)) && nodes.contains(&(26, 0.5)), "{nodes:?}");
        let anatomical = Geometry { space: Space::Lps, ..volume.geometry };
        assert!(mask.nodes(&anatomical).unwrap_err().what.contains("not in the same space"));
    }

    #[test]
    fn the_nodes_in_the_ball_are_found_and_no_others() {
        let geometry = Geometry::axis_aligned([20, 20, 20], DVec3::new(1.0, 0.5, 2.0));
        let ball = Ball { centre: DVec3::new(9.0, 5.0, 20.0), radius: 4.0, size: 0.5 };
        let want: Vec<usize> = (0..8000).filter(|&at| geometry.node_to_grid(at).distance(ball.centre) <= 4.0).collect();
        assert!(want.len() > 200);
        assert_eq!(ball.nodes(&geometry).collect::<Vec<_>>(), want);
        let tiny = Ball { centre: DVec3::new(9.5, 5.2, 21.0), radius: 1e-3, size: 0.25 };
        assert!(tiny.nodes(&geometry).count() >= 8);
        let elsewhere = Region::Ball(Ball { centre: DVec3::splat(-100.0), radius: 4.0, size: 0.5 });
        let error = elsewhere.nodes(&geometry).unwrap_err();
        assert!(error.what.contains("outside the grid of F"), "{error}");
        assert!(error.next.contains("the grid covers x 0 to 19, y 0 to 9.5, z 0 to 38 mm"), "{error}");
    }

    /// A ball is in the frame of F. A file of points is in its own frame, if it has one.
    #[test]
    fn balls_and_points_are_placed_in_both_frames() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("points.vtp");
        let lps = Geometry { space: Space::Lps, ..Geometry::axis_aligned([20, 20, 20], DVec3::ONE) };
        let lps = Geometry { origin: DVec3::new(-3.0, 12.0, 7.0), ..lps };
        let vertices = vec![DVec3::new(4.2, 5.1, 6.7), DVec3::new(12.0, 9.5, 3.5), DVec3::new(2.5, 14.0, 8.0)];
        let mut surface = Surface::from_grid(&TriangleMesh { vertices, triangles: vec![[0, 1, 2]] }, &lps);
        surface.point_data.push(DataArray::scalars("h", vec![0.5, 0.75, 1.0]));
        let history = Context::silent("reconstruct").history();
        write_surface(&file, &surface, &serde_json::Value::Null, &history).unwrap();
        let ras = lps.clone().in_space(Space::Ras);
        let points = Region::Points { file };
        assert_eq!(points.nodes(&ras).unwrap(), points.nodes(&lps).unwrap());
        let ball = |x, y| Ball { centre: DVec3::new(x, y, 14.0), radius: 3.0, size: 0.5 };
        let nodes: Vec<usize> = ball(5.0, 20.0).nodes(&lps).collect();
        assert!(nodes.len() > 100 && ball(-5.0, -20.0).nodes(&ras).eq(nodes));
    }

    /// Tests a mask whose grid is finer than the grid of F, shifted, and rotated by 90 degrees
    /// about z.
    #[test]
    fn a_mask_is_placed_by_its_world_coordinates() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("mask.vti");
        let place = Geometry {
            directions: glam::DMat3::from_cols(DVec3::Y, -DVec3::X, DVec3::Z),
            origin: DVec3::new(12.0, 3.0, 4.0),
            ..Geometry::axis_aligned([24, 20, 16], DVec3::splat(0.4))
        };
        let mut mask = Image::filled(place.clone(), 0.0f32);
        for k in 4..9 {
            for j in 2..12 {
                for i in 5..15 {
                    mask.data[place.linear(i, j, k)] = 1.0;
                }
            }
        }
        let field = |space| {
            let mask = Image { geometry: Geometry { space, ..place.clone() }, data: mask.data.clone() };
            Field { image: mask.into(), meta: serde_json::Value::Null, history: None, kind: FieldKind::Distance }
        };
        field(Space::Unnamed).write(&file).unwrap();
        // in world coordinates, the mask extends in x from 12 - 11.5 * 0.4 to 12 - 1.5 * 0.4, in y
        // from 3 + 4.5 * 0.4 to 3 + 14.5 * 0.4, and in z from 5.4 to 7.4
        let (low, high) = (DVec3::new(7.4, 4.8, 5.4), DVec3::new(11.4, 8.8, 7.4));
        let geometry = Geometry::axis_aligned([20, 20, 20], DVec3::ONE);
        let found = Region::Mask { file: file.clone(), size: 0.5 }.nodes(&geometry).unwrap();
        // a mask in LPS lies at the same place in a field in RAS
        field(Space::Lps).write(&file).unwrap();
        let lps = Geometry { space: Space::Lps, ..geometry.clone() };
        for space in [Space::Lps, Space::Ras] {
            let own = lps.clone().in_space(space);
            assert_eq!(Region::Mask { file: file.clone(), size: 0.5 }.nodes(&own).unwrap(), found);
        }
        for n in 0..geometry.voxel_count() {
            let p = geometry.node_to_grid(n);
            let is_found = found.contains(&(n, 0.5));
            if p.cmpge(low).all() && p.cmple(high).all() {
                assert!(is_found, "{p}");
            }
            // a mask voxel refines the whole cell around its centre, so nodes up to 1 mm outside
            // the mask may be found
            if p.cmplt(low - 1.0).any() || p.cmpgt(high + 1.0).any() {
                assert!(!is_found, "{p}");
            }
        }
        let far = Geometry { origin: DVec3::splat(500.0), ..geometry };
        assert!(Region::Mask { file, size: 0.5 }.nodes(&far).is_err());
    }
}
