//! The Delaunay triangulation of points on strata, with a material for each tetrahedron (Cheng, Dey
//! and Levine 2008). The facets between different materials form the interfaces.
//!
//! `topology.rs` and `criteria.rs` find where this complex differs from the strata of the
//! indicators, and `refine.rs` repairs it. Strata that pass a point within [`Complex::tolerance`]
//! are merged there at the end (`unite.rs`).

use super::prepare::Prepared;
use super::segments::Segments;
use crate::around::star;
use crate::interfaces::{Interfaces, Joined, Segment, segment};
use crate::labelled::{Facet, Labelled};
use crate::object::DEFAULT_DEVIATION;
use crate::options::Options;
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::materials::{Indicators, MaterialId, Stratum};
use isoparticles_field::spline::LEAST_GRADIENT;
use std::collections::BTreeSet;

/// Strata that pass a point within this distance are merged there. The unit is a voxel or, at a
/// scale, the larger of a voxel and h. New points are at least a twentieth of h from others
/// ([`crate::queue::NEAREST_FOR_TOPOLOGY`]), so they cannot separate strata within 0.05 h.
/// `brain_parcellation` at 100,000 vertices has 16 spurious junction edges with 0.05 voxel, and
/// none with 0.05, 0.1 or 0.2 h.
const ONE_STRATUM: f64 = 0.05;

/// Points on strata, and a material for each tetrahedron.
pub struct Complex<'a> {
    /// The triangulation, with the materials of its tetrahedra.
    pub labelled: Labelled<MaterialId>,
    /// The indicators.
    pub indicators: &'a dyn Indicators,
    /// Stratum of each point.
    pub strata: Vec<Stratum>,
    /// Target edge length h at each point, mm.
    pub sizes: Vec<f64>,
    /// Segments of junction curves.
    pub segments: Segments,
    /// Points at which strata are merged.
    pub(super) joined: BTreeSet<u32>,
    /// Maximum distance in mm between the centroid of a facet and its interface. `None`:
    /// [`crate::object::DEFAULT_DEVIATION`] times h, or times a voxel if that is longer.
    pub(super) max_deviation: Option<f64>,
    /// Whether voxel centres keep their materials (scale 0).
    keeps_voxels: bool,
}

impl<'a> Complex<'a> {
    /// Returns the interfaces that consist of some facets, and the dimension of the stratum of each
    /// vertex.
    pub fn interfaces(&self, facets: &[Facet]) -> (Interfaces, Vec<usize>) {
        let triangles = facets.iter().map(|f| (f.vertices, self.interface(f))).collect();
        let (mut interfaces, used) = Interfaces::compact(self.points(), triangles);
        let number = |v: u32| used.binary_search(&v).map_or(u32::MAX, |n| n as u32);
        let renumbered = |[a, b]: Segment| segment(number(a), number(b));
        interfaces.segments = self.segments.all().map(|(pair, curve)| (renumbered(pair), curve)).collect();
        interfaces.segments.sort_unstable();
        interfaces.first_beyond = self.indicators.first_beyond();
        let joined = self.joined.iter().map(|&v| Joined { vertex: number(v), distance: self.tolerance(v) });
        interfaces.joined = joined.filter(|own| own.vertex != u32::MAX).collect();
        let dimensions = used.iter().map(|&v| self.strata[v as usize].dimension()).collect();
        (interfaces, dimensions)
    }

    /// Creates the complex of prepared points, and assigns a material to each tetrahedron. `upper`
    /// is the last corner of the volume (grid frame, mm).
    pub fn new(prepared: Prepared, indicators: &'a dyn Indicators, upper: DVec3, options: &Options) -> Self {
        let Prepared { delaunay, strata, sizes, segments, .. } = prepared;
        let points = Points { indicators, strata: &strata, sizes: &sizes };
        let labelled = Labelled::new(delaunay, upper, |delaunay, t, centre| points.material(delaunay, t, centre));
        Self {
            labelled,
            indicators,
            strata,
            sizes,
            segments,
            joined: BTreeSet::new(),
            max_deviation: options.max_deviation,
            keeps_voxels: options.keeps_voxels,
        }
    }

    /// Assigns materials to the tetrahedra that were created since the last call.
    pub fn decide(&mut self) {
        let Self { labelled, indicators, strata, sizes, .. } = self;
        let points = Points { indicators: *indicators, strata, sizes };
        labelled.decide(|delaunay, t, centre| points.material(delaunay, t, centre));
    }

    /// Merges a stratum, which must pass a point within the tolerance, with that of the point. If
    /// more than four materials meet there, the stratum of the point is kept: four identify it.
    fn join(&mut self, point: u32, stratum: &Stratum) {
        let own = &mut self.strata[point as usize];
        if !own.is_on(stratum) {
            self.joined.insert(point);
        }
        *own = own.joined(stratum).unwrap_or(*own);
    }

    /// Returns the distance (mm) within which strata that pass a point are merged there:
    /// `ONE_STRATUM` times a voxel or, at a scale, times h if that is longer.
    pub fn tolerance(&self, point: u32) -> f64 {
        let voxel = self.indicators.voxel();
        ONE_STRATUM * if self.keeps_voxels { voxel } else { voxel.max(self.sizes[point as usize]) }
    }

    /// Returns whether the interfaces between the first and each other material of a stratum pass a
    /// point within the tolerance, to first order.
    fn is_passed(&self, point: u32, stratum: &Stratum) -> bool {
        let reach = self.tolerance(point);
        let (place, ids) = (self.points()[point as usize], stratum.materials());
        ids[1..].iter().all(|&other| {
            let (value, gradient) = self.indicators.difference_gradient(ids[0], other, place);
            value.abs() < reach * gradient.length().max(LEAST_GRADIENT)
        })
    }

    /// Makes an edge a segment if three or four materials occur once each around it, and if the
    /// interfaces between them pass both ends within the tolerance. Returns whether it became a
    /// segment.
    pub fn adopt(&mut self, edge: Segment) -> bool {
        let Some(start) = self.at_edge(edge) else { return false };
        let ids: Vec<MaterialId> = self.runs_round(edge, start).iter().map(|run| self.material(run[0])).collect();
        let Some(curve) = Stratum::new(&ids).filter(|curve| curve.dimension() < 2) else { return false };
        if !edge.iter().all(|&v| self.is_passed(v, &curve)) || !self.segments.adopt(edge, curve, self.labelled.points())
        {
            return false;
        }
        edge.into_iter().for_each(|v| self.join(v, &curve));
        true
    }

    /// Returns the points; inserted points come last.
    pub fn points(&self) -> &[DVec3] {
        self.labelled.points()
    }

    /// Returns the region of a tetrahedron.
    pub fn material(&self, tetrahedron: u32) -> MaterialId {
        self.labelled.of(tetrahedron)
    }

    /// Returns the regions inside and outside of a facet.
    pub fn regions_of(&self, facet: &Facet) -> [MaterialId; 2] {
        [self.material(facet.tetrahedron), self.material(self.labelled.across(facet))]
    }

    /// Returns the materials inside and outside of a facet. The outside is replaced by the space
    /// beyond a plane if all vertices of the facet lie in this plane.
    pub fn interface(&self, facet: &Facet) -> [MaterialId; 2] {
        let [inside, outside] = self.regions_of(facet);
        if outside != MaterialId::OUTSIDE {
            return [inside, outside];
        }
        let [first, others @ ..] = facet.vertices.map(|v| self.strata[v as usize]);
        let mut beyond = first.materials().iter().filter(|id| self.indicators.is_beyond(**id));
        [inside, beyond.find(|&&id| others.iter().all(|stratum| stratum.has(id))).copied().unwrap_or(outside)]
    }

    /// Returns whether a material is one of those that meet at a point.
    pub fn meets(&self, point: u32, id: MaterialId) -> bool {
        self.strata[point as usize].has(id)
    }

    /// Returns the number of regions that meet on a stratum.
    pub fn region_count(&self, stratum: &Stratum) -> usize {
        let mut regions = Vec::from_iter(stratum.materials().iter().map(|&id| self.indicators.region(id)));
        regions.sort_unstable();
        regions.dedup();
        regions.len()
    }

    /// Returns the mean target edge length h at the given points in mm.
    pub(super) fn size_of(&self, points: &[u32]) -> f64 {
        points.iter().map(|&v| self.sizes[v as usize]).sum::<f64>() / points.len() as f64
    }

    /// Returns the length of a segment in mm.
    pub fn length(&self, [a, b]: Segment) -> f64 {
        self.points()[a as usize].distance(self.points()[b as usize])
    }

    /// Returns a tetrahedron at an edge, or `None` if the triangulation does not have the edge.
    pub fn at_edge(&self, [a, b]: [u32; 2]) -> Option<u32> {
        let delaunay = self.labelled.delaunay();
        star(delaunay, a).into_iter().find(|&t| delaunay.vertices(t).contains(&b))
    }

    /// Returns the facet between two materials on three vertices (ascending), if there is one.
    pub fn facet_on(&self, vertices: [u32; 3]) -> Option<Facet> {
        self.labelled.facets_at(vertices[0]).into_iter().find(|f| f.sorted() == vertices)
    }
}

/// Data of the points from which the materials of tetrahedra are derived.
struct Points<'a> {
    indicators: &'a dyn Indicators,
    strata: &'a [Stratum],
    sizes: &'a [f64],
}

impl Points<'_> {
    /// Returns the region of a tetrahedron: that at its circumcentre, except in thin layers. The
    /// circumcentre may lie far beyond a layer, in a material that does not meet at all four
    /// vertices. The result is then the one of those that meet there with the minimum indicator at
    /// the centroid, if it is close to the centroid.
    fn material(&self, delaunay: &Delaunay, tetrahedron: u32, centre: Option<DVec3>) -> MaterialId {
        self.indicators.region(self.nearest_material(delaunay, tetrahedron, centre))
    }

    /// Returns the material of a tetrahedron, which may be the space beyond a plane.
    fn nearest_material(&self, delaunay: &Delaunay, tetrahedron: u32, centre: Option<DVec3>) -> MaterialId {
        let vertices = delaunay.vertices(tetrahedron);
        let at_centre = centre.map_or(MaterialId::OUTSIDE, |p| self.indicators.material_at(p));
        let [first, others @ ..] = vertices.map(|v| self.strata[v as usize]);
        let is_at_others = |id: &MaterialId| others.iter().all(|stratum| stratum.has(*id));
        let common: Vec<MaterialId> = first.materials().iter().copied().filter(is_at_others).collect();
        // four points of one plane span a tetrahedron whose volume is a rounding error
        if let Some(&beyond) = common.iter().find(|&&id| self.indicators.is_beyond(id)) {
            return beyond;
        }
        if common.is_empty() || common.contains(&at_centre) {
            return at_centre;
        }
        // the default limit of the deviation of a facet
        let size = vertices.iter().map(|&v| self.sizes[v as usize]).sum::<f64>() / 4.0;
        let reach = DEFAULT_DEVIATION * size.max(self.indicators.voxel());
        let centroid = vertices.iter().map(|&v| delaunay.points()[v as usize]).sum::<DVec3>() / 4.0;
        let near = self.indicators.near(centroid);
        let least = near.entries().first().map_or(0.0, |(_, value)| *value);
        // deep inside a material, its indicator is minus infinity
        let mut close = near.entries().iter().filter(|(_, value)| *value <= least + 2.0 * reach);
        close.find(|(id, _)| common.contains(id)).map_or(at_centre, |(id, _)| *id)
    }
}

#[cfg(test)]
mod tests {
    use super::super::scenes::stratum;
    use super::*;
    use crate::prepare::PrepareReport;
    use isoparticles_field::materials::{Analytic, half_space, maximum, negative};

    /// Returns the material of a tetrahedron with a vertex on each stratum, in a slab between z = 2
    /// and `top` with material 1 for x < 10 and 2 beyond. The outside lies above and below.
    fn label(top: f64, points: [[f64; 3]; 4], strata: [[u16; 2]; 4]) -> MaterialId {
        let plane = |x: f64, z: f64, normal: DVec3| half_space(DVec3::new(x, 0.0, z), normal);
        let slab = || maximum(plane(0.0, 2.0, DVec3::NEG_Z), plane(0.0, top, DVec3::Z));
        let [first, second] = [DVec3::X, DVec3::NEG_X].map(|normal| maximum(slab(), plane(10.0, 0.0, normal)));
        let analytic = Analytic::new(vec![negative(slab()), first, second], 1.0);
        let delaunay = Delaunay::new(&points.map(DVec3::from_array)).expect("four points in space");
        let (t, _) = delaunay.finite_tetrahedra().next().expect("a tetrahedron");
        let prepared = Prepared {
            segments: Segments::new([], delaunay.points()),
            delaunay,
            strata: strata.map(|ids| stratum(&ids)).to_vec(),
            sizes: vec![1.0; 4],
            report: PrepareReport::default(),
        };
        Complex::new(prepared, &analytic, DVec3::splat(40.0), &Options::default()).material(t)
    }

    #[test]
    fn tetrahedra_across_a_material_do_not_get_another() {
        // only the outside meets at all four vertices, but the tetrahedron lies in material 1
        let points = [[0.0, 5.0, 2.0], [5.0, 1.0, 10.0], [5.0, 9.0, 10.0], [10.5, 5.0, 2.0]];
        assert_eq!(label(10.0, points, [[0, 1], [0, 1], [0, 1], [0, 2]]), MaterialId(1));
    }

    #[test]
    fn tetrahedra_across_a_thin_layer_get_its_material() {
        // the circumcentre lies far above or below the layer, in the outside
        let points = [[2.0, 5.0, 2.0], [5.0, 1.0, 2.5], [5.0, 9.0, 2.5], [10.0, 5.5, 2.3]];
        assert_eq!(label(2.5, points, [[0, 1], [0, 1], [0, 1], [1, 2]]), MaterialId(1));
    }
}
