//! Tight Cocone (Dey and Goswami 2003): computes a closed surface from points alone, by the shape
//! of their Voronoi cells.
//!
//! On a well-sampled smooth surface, a Voronoi cell is long and thin along the normal. Its farthest
//! vertices, the *poles*, give the normal (Amenta and Bern 1999). The *cocone* is the part of the
//! cell within pi/8 of the tangent plane. Delaunay triangles whose dual edges intersect the cocones
//! are candidates (Amenta, Choi, Dey and Leekha 2000). Points whose cells are not flat, at
//! undersampled regions and boundaries, are ignored (Dey and Giesen 2001).
//!
//! `cells` computes poles, flat points and candidates. `umbrellas` finds the candidates that
//! separate the two poles of a point. `walk` orients the normals consistently. `peel` marks
//! tetrahedra and removes those outside. `repair` separates parts of the surface that touch. The
//! result is the boundary of a set of tetrahedra, so it is closed for any set of points.

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

/// Minimum share of given normals close to the direction to the pole. Below it, the given normals
/// are not used.
const NORMALS_TRUSTED: f64 = 0.75;

/// Minimum share of given normals on the convex hull that point to the same side of it. Below it,
/// the given normals do not determine the outside.
const NORMALS_ORIENTED: f64 = 0.9;

/// Minimum share of points with an umbrella. Below it, the surface would be arbitrary, and an error
/// is returned.
const FEWEST_UMBRELLAS: f64 = 0.5;

/// Counts and measurements of Tight Cocone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CoconeReport {
    /// Number of distinct points.
    pub points: usize,
    /// Points whose Voronoi cells are long and thin, and whose normals agree with those of their
    /// neighbours.
    pub flat: usize,
    /// Points with an umbrella: candidate triangles that separate the two poles.
    pub with_umbrella: usize,
    /// Points that are not vertices of the surface.
    pub unused: usize,
    /// Tetrahedra that changed sides because parts of the surface touched at an edge or a vertex.
    pub changed_sides: usize,
    /// Share of the given normals within 60 degrees of the direction to the pole, up to sign.
    /// `None` if no normals are given or all are zero.
    pub normals_near_poles: Option<f64>,
    /// Whether the given normals were used instead of the direction to the pole.
    pub normals_taken: bool,
    /// Whether the given normals determined the outside.
    pub normals_oriented: bool,
    /// Share of the triangles that face to the side of the given normals, among those with normals
    /// at their vertices. `None` if there are none.
    pub facing_normals: Option<f64>,
}

/// Returns the surface through the points of a triangulation, as facets that are counter-clockwise
/// as seen from outside. `normals` contains one vector of any length for each point, zero if
/// unknown. The vectors need not point outward.
///
/// # Errors
/// If fewer than half of the points have an umbrella, or no tetrahedron is inside the surface.
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
    // estimated normals have no orientation, so a single point without a given normal requires the
    // walk
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
