//! Regions where the user wants smaller triangles: the paper's wish (section 7) to add particles where they matter.

use glam::DVec3;
use isoparticles_common::geometry::Geometry;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// A ball in which h is at most `size`; outside it h grows at the rate delta.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// Centre in world coordinates, mm.
    pub centre: DVec3,
    /// Radius, mm.
    pub radius: f64,
    /// Largest h in it, mm.
    pub size: f64,
}

impl FromStr for Region {
    type Err = String;

    /// Reads `ball:X,Y,Z,RADIUS=H`.
    fn from_str(text: &str) -> Result<Self, String> {
        let form = || "write it as ball:X,Y,Z,RADIUS=H, all in mm".to_owned();
        let (place, size) = text.strip_prefix("ball:").and_then(|t| t.split_once('=')).ok_or_else(form)?;
        let number = |t: &str| t.trim().parse::<f64>().ok().filter(|x| x.is_finite()).ok_or_else(form);
        let place: Vec<f64> = place.split(',').map(number).collect::<Result<_, _>>()?;
        let &[x, y, z, radius] = place.as_slice() else { return Err(form()) };
        let size = number(size)?;
        if radius <= 0.0 || size <= 0.0 {
            return Err("radius and h must be above 0".into());
        }
        Ok(Self { centre: DVec3::new(x, y, z), radius, size })
    }
}

impl Region {
    /// The nodes of a grid that lie in the ball, at the least those around its centre; none when it lies outside the grid.
    pub fn nodes<'a>(&self, geometry: &'a Geometry) -> impl Iterator<Item = usize> + 'a {
        let centre = geometry.world_to_grid(self.centre);
        let reach = self.radius.max(geometry.spacing.length());
        let low = geometry.grid_to_index(centre - reach).ceil();
        let high = geometry.grid_to_index(centre + reach).floor();
        // casts saturate: what lies before the first node gives an empty range, too
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_read_or_refused_with_the_form() {
        let region: Region = "ball:1,-2.5, 3,4=0.5".parse().unwrap();
        assert_eq!(region, Region { centre: DVec3::new(1.0, -2.5, 3.0), radius: 4.0, size: 0.5 });
        for wrong in ["", "ball:1,2,3=1", "ball:1,2,3,4", "box:1,2,3,4=1", "ball:1,2,x,4=1", "ball:1,2,3,inf=1"] {
            assert!(wrong.parse::<Region>().unwrap_err().contains("ball:X,Y,Z,RADIUS=H"), "{wrong}");
        }
        for wrong in ["ball:1,2,3,0=1", "ball:1,2,3,4=-1"] {
            assert!(wrong.parse::<Region>().unwrap_err().contains("above 0"), "{wrong}");
        }
    }

    #[test]
    fn the_nodes_in_the_ball_are_found_and_no_others() {
        let geometry = Geometry::axis_aligned([20, 20, 20], DVec3::new(1.0, 0.5, 2.0));
        let region = Region { centre: DVec3::new(9.0, 5.0, 20.0), radius: 4.0, size: 0.5 };
        let place = |at: usize| DVec3::new((at % 20) as f64, (at / 20 % 20) as f64 * 0.5, (at / 400) as f64 * 2.0);
        let want: Vec<usize> = (0..8000).filter(|&at| place(at).distance(region.centre) <= 4.0).collect();
        assert!(want.len() > 200);
        assert_eq!(region.nodes(&geometry).collect::<Vec<_>>(), want);
        let tiny = Region { centre: DVec3::new(9.5, 5.2, 21.0), radius: 1e-3, size: 0.25 };
        assert!(tiny.nodes(&geometry).count() >= 8);
        let elsewhere = Region { centre: DVec3::splat(-100.0), radius: 4.0, size: 0.5 };
        assert_eq!(elsewhere.nodes(&geometry).count(), 0);
    }
}
