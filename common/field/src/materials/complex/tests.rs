//! Tests of complexes of known shapes: number, position, length and area of their interfaces,
//! curves and points.

use super::*;
use crate::materials::tests::{CENTRE, IDS, corners, nested, sampled, sectors};
use crate::materials::{Analytic, Bound, Bounded, MaterialId, ball, half_space, maximum, minimum, negative};
use crate::sizing::SizingField;
use crate::spline::Jet;
use glam::{DVec2, DVec3};
use isoparticles_volume::Image;
use std::f64::consts::PI;

/// Returns the grid of a cube that contains the shapes. Its edge length is 24 mm, and its nodes are
/// `spacing` mm apart.
fn grid(spacing: f64) -> Geometry {
    Geometry::axis_aligned([(24.0 / spacing).round() as usize + 1; 3], DVec3::splat(spacing))
}

/// Computes the complex of analytic indicators on all cells of the grid, in two boxes of cells.
fn exact(analytic: &Analytic, spacing: f64) -> Complex {
    let grid = grid(spacing);
    let cells = grid.size.map(|n| n - 1);
    let half = cells[2] / 2;
    let boxes = [([0; 3], [cells[0], cells[1], half]), ([0, 0, half], [cells[0], cells[1], cells[2] - half])];
    Complex::of_bricks(analytic, &grid, &boxes)
}

type Function = Box<dyn Fn(DVec3) -> Jet + Send + Sync>;

fn scaled(a: Function, factor: f64) -> Function {
    Box::new(move |p| {
        let Jet { value, gradient, hessian } = a(p);
        Jet { value: factor * value, gradient: factor * gradient, hessian: hessian * factor }
    })
}

fn sum(a: Function, b: Function) -> Function {
    Box::new(move |p| {
        let (a, b) = (a(p), b(p));
        Jet { value: a.value + b.value, gradient: a.gradient + b.gradient, hessian: a.hessian + b.hessian }
    })
}

/// Two overlapping balls of radius 5 mm, separated by the plane midway between their centres. The
/// junction curve is a circle of radius 3 mm. Away from this circle, the difference of two
/// indicators is smooth on their interface.
fn touching() -> Analytic {
    let way = DVec3::new(2.0, -1.0, 1.5).normalize();
    let side = |way: DVec3| scaled(half_space(CENTRE, way), 0.5);
    let both = minimum(ball(CENTRE + 4.0 * way, 5.0), ball(CENTRE - 4.0 * way, 5.0));
    let outside = sum(minimum(side(way), side(-way)), negative(both));
    Analytic::new(vec![outside, side(-way), side(way)], 1.0)
}

/// A lens in the plane between two materials. It is the intersection of two balls of radius 10 mm
/// with centres 12 mm apart. The junction curve is a circle of radius 8 mm.
fn lens() -> Analytic {
    let way = DVec3::new(0.3, 0.2, 1.0).normalize();
    let side = |way: DVec3| scaled(half_space(CENTRE, way), 0.5);
    let own = maximum(ball(CENTRE + 6.0 * way, 10.0), ball(CENTRE - 6.0 * way, 10.0));
    Analytic::new(vec![side(way), side(-way), sum(minimum(side(way), side(-way)), own)], 1.0)
}

/// A ball of radius 8 mm, divided into three sectors of 120 degrees. Their indicators are smooth
/// except at the centre of the ball.
fn smooth_sectors() -> Analytic {
    let way = |n: f64| DVec2::from_angle((n / 3.0 + 0.1) * std::f64::consts::TAU).extend(0.0);
    let wedge = |n: f64| scaled(half_space(CENTRE, -way(n)), 0.5);
    let sector = |n: f64| sum(scaled(ball(CENTRE, 8.0), 0.5), wedge(n));
    let nearest = minimum(minimum(wedge(0.0), wedge(1.0)), wedge(2.0));
    let outside = sum(scaled(ball(CENTRE, 8.0), -0.5), nearest);
    Analytic::new(vec![outside, sector(0.0), sector(1.0), sector(2.0)], 1.0)
}

fn stratum(ids: &[usize]) -> Stratum {
    Stratum::new(&ids.iter().map(|&n| IDS[n]).collect::<Vec<_>>()).expect("valid")
}

/// Checks that two triangles meet at each edge of an interface, except along curves and the border.
fn is_closed(complex: &Complex) {
    let mut edges = std::collections::BTreeMap::new();
    for triangle in &complex.triangles {
        let [a, b, c] = triangle.corners;
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((triangle.interface, from.min(to), from.max(to))).or_insert(0) +=
                if from < to { 1 } else { -1 };
        }
    }
    for ((interface, a, b), sum) in edges {
        let ends = [a, b].map(|v| complex.vertices[v as usize].stratum);
        let places = [a, b].map(|v| complex.vertices[v as usize].position);
        let is_edge = |face: f64| (0..3).any(|axis| places.iter().all(|p| (p[axis] - face).abs() < 0.1));
        let is_border = ends.iter().all(|end| end.count() > 2) || is_edge(0.0) || is_edge(24.0);
        assert!(sum == 0 || is_border, "{interface:?}: {places:?} {ends:?} {sum}");
    }
}

/// Returns the number of triangles whose normal does not point from the material with the higher
/// number to the material with the lower number.
fn turned(complex: &Complex, indicators: &impl Indicators) -> usize {
    let is_turned = |triangle: &&Triangle| {
        let [a, b, c] = complex.corners(triangle);
        let (normal, centre) = ((b - a).cross(c - a), (a + b + c) / 3.0);
        let &[low, high] = triangle.interface.materials() else { return true };
        let gradient = indicators.difference_gradient(high, low, centre).1;
        normal.dot(gradient) < -1e-3 * normal.length() * gradient.length()
    };
    complex.triangles.iter().filter(is_turned).count()
}

#[test]
fn nested_balls_have_two_closed_interfaces_whose_areas_converge() {
    let errors = |complex: &Complex| {
        assert_eq!((complex.chains.len(), complex.points.len(), complex.interface_components().1), (0, 0, 2));
        is_closed(complex);
        let areas = complex.areas();
        let error = |interface: Stratum, radius: f64| (areas[&interface] / (4.0 * PI * radius * radius) - 1.0).abs();
        error(stratum(&[0, 1]), 9.0).max(error(stratum(&[1, 2]), 5.0))
    };
    let analytic = nested(CENTRE);
    let (coarse, fine) = (exact(&analytic, 1.0), exact(&analytic, 0.5));
    assert_eq!((turned(&coarse, &analytic), turned(&fine, &analytic)), (0, 0));
    let (coarse, fine) = (errors(&coarse), errors(&fine));
    assert!(coarse < 0.02 && fine < coarse / 3.0, "{coarse} {fine}");
    let (coarse, fine) =
        (errors(&Complex::new(&sampled(&analytic, 1.0))), errors(&Complex::new(&sampled(&analytic, 0.5))));
    assert!(coarse < 0.03 && fine < coarse / 3.0, "sampled: {coarse} {fine}");
}

#[test]
fn three_sectors_of_a_ball_have_four_curves_and_two_points() {
    let analytic = smooth_sectors();
    let errors = |complex: &Complex| {
        is_closed(complex);
        assert_eq!((complex.chains.len(), complex.points.len(), complex.interface_components().1), (4, 2, 6));
        let mut place = 0.0f64;
        for point in &complex.points {
            assert_eq!(point.stratum, stratum(&[0, 1, 2, 3]));
            place = place
                .max(((point.position - CENTRE).length() - 8.0).abs())
                .max((point.position - CENTRE).truncate().length());
        }
        let lengths = complex.lengths();
        let (areas, third) = (complex.areas(), 4.0 * PI * 64.0 / 3.0);
        let (mut length, mut area) = ((lengths[&stratum(&[1, 2, 3])] / 16.0 - 1.0).abs(), 0.0f64);
        for [a, b] in [[1, 2], [2, 3], [1, 3]] {
            length = length.max((lengths[&stratum(&[0, a, b])] / (8.0 * PI) - 1.0).abs());
            area = area.max((areas[&stratum(&[a, b])] / (32.0 * PI) - 1.0).abs());
        }
        for own in 1..4 {
            area = area.max((areas[&stratum(&[0, own])] / third - 1.0).abs());
        }
        for chain in &complex.chains {
            let [End::Point(a), End::Point(b)] = chain.ends else { panic!("{chain:?}") };
            assert_ne!(a, b);
        }
        [place, length, area]
    };
    let (coarse, fine) = (errors(&exact(&analytic, 1.0)), errors(&exact(&analytic, 0.5)));
    assert!(coarse[0] < 1e-6 && fine[0] < 1e-6, "points {coarse:?} {fine:?}");
    // the step length along curves does not depend on the grid spacing, so both lengths must be
    // equally accurate
    assert!(coarse[1] < 1e-4 && fine[1] < 1e-4, "lengths {coarse:?} {fine:?}");
    // triangles next to curves may fold slightly, so second-order convergence is not required
    assert!(coarse[2] < 2.5e-3 && fine[2] < 2e-3, "areas {coarse:?} {fine:?}");
    // the indicators are signed distances with kinks that the splines round off, so the errors are
    // proportional to the spacing
    let of_samples = |spacing: f64| errors(&Complex::new(&sampled(&sectors(CENTRE), spacing)));
    let (coarse, fine) = (of_samples(1.0), of_samples(0.5));
    assert!(coarse.iter().zip([0.4, 0.05, 0.05]).all(|(error, most)| *error < most), "sampled: {coarse:?}");
    assert!(fine.iter().zip([0.2, 0.025, 0.025]).all(|(error, most)| *error < most), "sampled: {fine:?}");
}

#[test]
fn four_regions_of_a_cube_have_four_curves_and_one_point() {
    let analytic = corners(CENTRE);
    for (complex, most) in [(exact(&analytic, 1.5), 1e-6), (Complex::new(&sampled(&analytic, 1.5)), 0.4)] {
        is_closed(&complex);
        assert_eq!((complex.chains.len(), complex.points.len(), complex.interface_components().1), (4, 1, 6));
        assert!(complex.points[0].position.distance(CENTRE) < most, "{:?}", complex.points);
        for chain in &complex.chains {
            let mut ends = chain.ends;
            ends.sort_by_key(|end| *end == End::Border);
            assert_eq!(ends, [End::Point(0), End::Border]);
            for v in &chain.vertices {
                // each curve lies on a ray at equal distances from three corners of the tetrahedron
                let away = (complex.vertices[*v as usize].position - CENTRE).abs();
                assert!(away.max_element() - away.min_element() < most.max(1e-3), "{away}");
            }
        }
    }
}

#[test]
fn touching_balls_and_a_lens_have_one_closed_curve() {
    for (analytic, curve, radius) in [(touching(), [0, 1, 2], 3.0), (lens(), [0, 1, 2], 8.0)] {
        let error = |spacing: f64| {
            let complex = exact(&analytic, spacing);
            is_closed(&complex);
            assert_eq!((complex.chains.len(), complex.points.len(), complex.interface_components().1), (1, 0, 3));
            assert!(complex.chains[0].is_closed() && complex.chains[0].curve == stratum(&curve));
            for &v in &complex.chains[0].vertices {
                let away = complex.vertices[v as usize].position.distance(CENTRE);
                assert!((away - radius).abs() < 1e-6, "{away}");
            }
            (complex.length(&complex.chains[0]) / (2.0 * PI * radius) - 1.0).abs()
        };
        // the step length along the curve does not depend on the grid spacing, so both lengths must
        // be equally accurate
        let (coarse, fine) = (error(1.0), error(0.5));
        assert!(coarse < 2.5e-4 && fine < 2.5e-4, "{coarse} {fine}");
    }
}

#[test]
fn a_layer_thinner_than_a_cell_is_not_passed_over() {
    // a slanted layer that is 0.4 mm thick; lattice edges of 1.5 mm cross it between nodes in the
    // materials on either side
    let way = DVec3::new(0.4, -0.5, 0.8).normalize();
    let low = half_space(CENTRE - 0.2 * way, way);
    let high = half_space(CENTRE + 0.2 * way, -way);
    let layer = maximum(half_space(CENTRE + 0.2 * way, way), half_space(CENTRE - 0.2 * way, -way));
    let analytic = Analytic::new(vec![low, layer, high], 1.5);
    let complex = exact(&analytic, 1.5);
    is_closed(&complex);
    assert_eq!((complex.chains.len(), complex.interface_components().1), (0, 2), "{:?}", complex.tally);
}

#[test]
fn counts_are_those_of_the_lattice() {
    let complex = exact(&smooth_sectors(), 0.5);
    let h = 0.8;
    let sizing = SizingField::new(Image::filled(grid(0.5), h as f32));
    let area = 4.0 * PI * 64.0 + 3.0 * 32.0 * PI;
    let length = 16.0 + 3.0 * 8.0 * PI;
    let expected = 2.0 / 3f64.sqrt() * area / (h * h) - 0.5 * length / h + 2.0;
    assert!((complex.predicted_count(&sizing) / expected - 1.0).abs() < 0.01);
}

#[test]
fn threads_make_no_difference() {
    let materials = sampled(&sectors(CENTRE), 1.5);
    let pool = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let [one, three] = [1, 3].map(|threads| pool(threads).install(|| Complex::new(&materials)));
    assert_eq!(one, three);
}

#[test]
fn a_junction_point_of_curves_that_all_but_coincide_is_met_once() {
    // four quarters around an axis; two opposite quarters widen along the axis so slowly that, a
    // voxel from the junction point, all four indicators are equal to within a fiftieth of a voxel
    let along = DVec3::new(0.2, 0.1, 1.0).normalize();
    let (across, other) = along.any_orthonormal_pair();
    let quarter = |n: u32| {
        let (sin, cos) = (0.3 + f64::from(n) * 0.5 * PI).sin_cos();
        let growth = if n.is_multiple_of(2) { 0.01 } else { -0.01 };
        sum(half_space(CENTRE, -(cos * across + sin * other)), scaled(half_space(CENTRE, along), growth))
    };
    let analytic = Analytic::new((0..4).map(quarter).collect(), 1.0);
    for (complex, most) in [(exact(&analytic, 1.0), 1e-3), (Complex::new(&sampled(&analytic, 1.0)), 0.2)] {
        assert_eq!(complex.points.len(), 1, "{:?}", complex.points);
        assert!(complex.points[0].position.distance(CENTRE) < most, "{:?}", complex.points);
        let mut curves: Vec<Stratum> = complex.chains.iter().map(|chain| chain.curve).collect();
        curves.sort_unstable();
        assert_eq!(curves, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]].map(|ids| stratum(&ids)));
        assert!(complex.chains.iter().all(|chain| chain.ends.contains(&End::Point(0))));
    }
}

/// Planes at some distances (mm) from [`CENTRE`], with perpendicular normals. The first normal is
/// oblique to the grid.
fn planes(distances: &[f64]) -> Vec<Bound> {
    let first = DVec3::new(0.3, -0.4, 1.2).normalize();
    let normals = [first, first.any_orthonormal_vector()];
    let bound = |(&distance, normal): (&f64, DVec3)| Bound {
        name: "cut".to_owned(),
        point: CENTRE + distance * normal,
        normal,
    };
    distances.iter().zip(normals).map(bound).collect()
}

#[test]
fn planes_cut_nested_balls_along_sharp_rims() {
    let (analytic, bounds) = (nested(CENTRE), planes(&[3.0]));
    let cut = MaterialId(3);
    let with_cut = |ids: &[usize]| {
        let ids: Vec<MaterialId> = ids.iter().map(|&n| IDS[n]).chain([cut]).collect();
        Stratum::new(&ids).expect("valid")
    };
    let errors = |complex: &Complex| {
        is_closed(complex);
        assert_eq!((complex.chains.len(), complex.points.len(), complex.interface_components().1), (2, 0, 4));
        assert!(complex.triangles.iter().all(|triangle| triangle.interface != with_cut(&[0])));
        for vertex in complex.chains.iter().flat_map(|chain| &chain.vertices) {
            assert!(bounds[0].distance(complex.vertices[*vertex as usize].position).abs() < 1e-6);
        }
        let on_cut = complex.vertices.iter().filter(|vertex| vertex.stratum.has(cut));
        let off = on_cut.map(|vertex| bounds[0].distance(vertex.position).abs()).fold(0.0, f64::max);
        assert!(off < 1e-9, "{off}");
        let (areas, lengths) = (complex.areas(), complex.lengths());
        let ratios = [
            areas[&with_cut(&[2])] / (PI * 16.0),
            areas[&with_cut(&[1])] / (PI * 56.0),
            areas[&stratum(&[0, 1])] / (2.0 * PI * 9.0 * 12.0),
            areas[&stratum(&[1, 2])] / (2.0 * PI * 5.0 * 8.0),
            lengths[&with_cut(&[1, 2])] / (2.0 * PI * 4.0),
            lengths[&with_cut(&[0, 1])] / (2.0 * PI * 72f64.sqrt()),
        ];
        ratios.into_iter().map(|ratio| (ratio - 1.0).abs()).fold(0.0, f64::max)
    };
    let exact = |spacing: f64| {
        let (grid, analytic) = (grid(spacing), nested(CENTRE));
        let cells = grid.size.map(|n| n - 1);
        Complex::of_bricks(&Bounded::new(analytic, &bounds, cut, grid.spacing.length()), &grid, &[([0; 3], cells)])
    };
    let (coarse, fine) = (errors(&exact(1.0)), errors(&exact(0.5)));
    assert!(coarse < 0.03 && fine < coarse / 3.0, "{coarse} {fine}");
    let sampled = |spacing: f64| Complex::new(&sampled(&analytic, spacing).with_bounds(bounds.clone()));
    let (coarse, fine) = (errors(&sampled(1.0)), errors(&sampled(0.5)));
    assert!(coarse < 0.03 && fine < coarse / 3.0, "sampled: {coarse} {fine}");
}

#[test]
fn two_planes_meet_on_curves_within_the_materials_only() {
    let bounds = planes(&[3.0, 2.0]);
    let complex = Complex::new(&sampled(&nested(CENTRE), 0.5).with_bounds(bounds.clone()));
    is_closed(&complex);
    assert_eq!((complex.points.len(), complex.tally.points_irregular), (4, 0));
    for point in &complex.points {
        let radius = point.position.distance(CENTRE);
        assert!((radius - 9.0).abs().min((radius - 5.0).abs()) < 0.01, "{point:?}");
        assert!(bounds.iter().all(|bound| bound.distance(point.position).abs() < 1e-6), "{point:?}");
    }
    let lengths = complex.lengths();
    let of = |id: u16| lengths[&Stratum::new(&[id, 3, 4].map(MaterialId)).expect("three")];
    let (inner, outer) = (2.0 * 12f64.sqrt(), 2.0 * 68f64.sqrt());
    assert!((of(2) / inner - 1.0).abs() < 0.01 && (of(1) / (outer - inner) - 1.0).abs() < 0.01, "{lengths:?}");
    assert!(!lengths.contains_key(&Stratum::new(&[0, 3, 4].map(MaterialId)).expect("three")));
}
