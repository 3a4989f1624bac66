//! Tight Cocone (Dey and Goswami 2003): a watertight surface from points alone, by the shape of their Voronoi cells.
//!
//! On a well-sampled smooth surface a Voronoi cell is long and thin along the normal; its farthest corners, the *poles* (Amenta and
//! Bern 1999), give the normal, and the Delaunay triangles whose dual edges pass through the *cocones* (the part of the cell within
//! pi/8 of the tangent plane, Amenta, Choi, Dey and Leekha 2000) are candidates for the surface. Vertices whose cells are not flat lie
//! where the sampling ends or is too sparse (Dey and Giesen 2001) and have no say. The steps: `cells` finds poles, flat
//! vertices and candidates; `umbrellas` finds where the candidates part a vertex's tetrahedra, and which are on which side; `walk`
//! gives the normals of each sheet one sense; `peel` marks tetrahedra and eats away those outside; `repair` parts what touches in
//! an edge or a vertex. What is left is a set of tetrahedra, so its boundary is closed whatever the points.

mod cells;
mod peel;
mod repair;
#[cfg(test)]
mod tests;
mod umbrellas;
mod walk;

use crate::restricted::Facet;
use cells::Cells;
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_stage::error::{Error, Result};
use serde::Serialize;
use umbrellas::Umbrellas;
use walk::Sheets;

/// Given normals are taken where this share of them lies near the direction to the pole.
const NORMALS_TRUSTED: f64 = 0.75;

/// Given normals are outward (or all inward) where this share of those on the convex hull points that way.
const NORMALS_ORIENTED: f64 = 0.9;

/// Where a smaller share of the points has an umbrella, the surface would be guesswork.
const FEWEST_UMBRELLAS: f64 = 0.5;

/// What was found on the way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CoconeReport {
    /// Distinct points.
    pub points: usize,
    /// Points whose Voronoi cells are long and thin and whose neighbours agree.
    pub flat: usize,
    /// Points round which the candidate triangles part outside from inside.
    pub with_umbrella: usize,
    /// Points that no triangle of the surface uses.
    pub unused: usize,
    /// Tetrahedra that changed sides because parts of the surface touched in an edge or a vertex.
    pub changed_sides: usize,
    /// Share of the given normals that lie within 60 degrees of the direction to the pole, as lines; `None` without normals, or when
    /// all of them are zero.
    pub normals_near_poles: Option<f64>,
    /// Whether given normals took the place of the direction to the pole.
    pub normals_taken: bool,
    /// Whether given normals said which side is outside.
    pub normals_oriented: bool,
    /// Share of the triangles that face the way of the given normals, of those at points with normals; `None` when there are none.
    pub facing_normals: Option<f64>,
}

/// The surface of the points of a triangulation, as facets counter-clockwise seen from outside. `normals`, where there are any, are
/// one a point, of any length, zero where unknown; they need not point outward.
///
/// # Errors
/// When no part of the points is sampled densely and evenly enough to be the surface of a solid.
pub fn tight_cocone(delaunay: &Delaunay, normals: Option<&[DVec3]>) -> Result<(Vec<Facet>, CoconeReport)> {
    let is_known = |normal: &DVec3| normal.try_normalize().is_some();
    let normals = normals.filter(|normals| normals.iter().any(is_known));
    let mut report = CoconeReport { points: delaunay.vertex_count(), ..CoconeReport::default() };
    let mut cells = Cells::new(delaunay, normals);
    if normals.is_some() {
        report.normals_near_poles = Some(cells.normals_near_poles);
        report.normals_taken = cells.normals_near_poles >= NORMALS_TRUSTED;
        if !report.normals_taken {
            cells = Cells::new(delaunay, None);
        }
    }
    report.flat = cells.is_flat.iter().filter(|&&flat| flat).count();
    let umbrellas = Umbrellas::new(&cells);
    report.with_umbrella = umbrellas.is_good.iter().filter(|&&good| good).count();
    if (report.with_umbrella as f64) < FEWEST_UMBRELLAS * report.points as f64 {
        return Err(encloses_nothing(&format!("only {}", umbrellas_found(&report))));
    }
    // estimates have no sense of their own, so one point without a normal leaves the sense to the walk
    let all_known = || normals.is_some_and(|n| n.iter().zip(&umbrellas.is_good).all(|(n, good)| !good || is_known(n)));
    let outward = cells.normals_out_of_hull;
    let is_oriented = !(1.0 - NORMALS_ORIENTED..NORMALS_ORIENTED).contains(&outward);
    report.normals_oriented = report.normals_taken && is_oriented && all_known();
    let mut sheets = if report.normals_oriented {
        Sheets::given(delaunay.points().len(), if outward < 0.5 { -1 } else { 1 })
    } else {
        Sheets::walk(&cells, &umbrellas)
    };
    let mut is_out = peel::peel(&cells, &umbrellas, &mut sheets);
    let facets;
    (facets, report.changed_sides) = repair::part_pinches(&cells, &umbrellas, &mut is_out);
    if facets.is_empty() {
        let found = umbrellas_found(&report);
        return Err(encloses_nothing(&format!("{found}, but no tetrahedron lies inside of them")));
    }
    let mut used = vec![false; delaunay.points().len()];
    facets.iter().flat_map(|f| f.vertices).for_each(|v| used[v as usize] = true);
    report.unused = report.points - used.iter().filter(|&&used| used).count();
    report.facing_normals = normals.and_then(|normals| peel::agreement(delaunay, &facets, normals));
    Ok((facets, report))
}

fn umbrellas_found(report: &CoconeReport) -> String {
    format!("{} of {} points have an umbrella of triangles", report.with_umbrella, report.points)
}

fn encloses_nothing(found: &str) -> Error {
    Error::input(
        format!("the points do not enclose a solid: {found}"),
        "Tight Cocone needs points that sample the surface of a solid about evenly, at a fraction of its thickness, with little noise",
        "give more points, thin or smooth noisy ones, or give their normals; where there is a volume, use --method restricted",
    )
}
