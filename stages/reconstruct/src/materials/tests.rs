//! Compares complexes of known shapes with the exact strata, volumes and areas.

use super::complex::Complex;
use super::nodes::Nodes;
use super::prepare::{Prepared, prepare};
use super::reconstruct::reconstruct;
use super::refine::Refinement;
use super::scenes::{self, CENTRE, HALF, RADIUS, Scene, stratum};
use super::subject::Materials;
use crate::check::{CheckOptions, CheckReport, Fault, check};
use crate::complete::{Joining, Reconstruction};
use crate::interfaces::Interfaces;
use crate::options::Options;
use crate::queue::{Refine, Simplex};
use crate::subject::{Subject, Topology};
use glam::DVec3;
use isoparticles_field::materials::{Analytic, Indicators, MaterialId, Stratum, ball, half_space, negative};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_mesh::measure::measure;
use isoparticles_stage::cli::values::place;
use isoparticles_stage::error::Error;
use isoparticles_stage::monitor::Silent;
use isoparticles_volume::Geometry;
use std::f64::consts::PI;

impl Reconstruction {
    /// Returns the reports of the steps that join particles.
    fn joined(&self) -> &Joining {
        self.joining.as_ref().expect("not an update")
    }
}

/// Returns the checked complex of the particles of a scene.
fn made(scene: &Scene, indicators: &dyn Indicators, h: f64, keeps_voxels: bool) -> Reconstruction {
    let (particles, strata) = scene.particles(h, 0.75);
    let options = Options { keeps_voxels, ..Options::default() };
    reconstruct((&particles, &strata), indicators, &scene.table(), None, &options, &Silent).expect("on their strata")
}

fn ball_volume(radius: f64) -> f64 {
    4.0 / 3.0 * PI * radius.powi(3)
}

/// Returns the volume of each material except the outside.
fn volumes(made: &Reconstruction) -> Vec<f64> {
    made.checked.regions.iter().skip(1).map(|own| own.volume).collect()
}

fn assert_sound(made: &Reconstruction, what: &str) {
    assert_eq!(made.failed, Vec::<String>::new(), "{what}: {:?} {:?}", made.joined().refined, made.improved);
    // grid nodes in another material may be left to the optimiser
    assert!(
        made.joined().refined.unresolved.keys().all(|reason| !reason.is_topology()),
        "{what}: {:?}",
        made.joined().refined
    );
    assert_eq!(
        [Fault::NodesOnWrongSide, Fault::MissingSegments].map(|fault| made.checked.count(fault)),
        [0, 0],
        "{what}"
    );
    let quality = &made.checked.quality;
    let (mean, least) = (quality.radius_ratio_mean, quality.radius_ratio_min);
    // the particles are random, not settled
    assert!(mean > 0.88 && least > 0.45, "{what}: {mean} {least}");
}

#[test]
fn known_shapes_have_their_strata_and_keep_every_node() {
    for (name, scene, junctions, points) in [
        ("nested", scenes::nested(), 0, 0),
        ("sectors", scenes::sectors(), 30, 2),
        ("two balls", scenes::two_balls(), 12, 0),
        ("quarters", scenes::quarters(), 50, 5),
    ] {
        let sampled = scene.sampled(1.0);
        let analytic = &scene.analytic as &dyn Indicators;
        // From outside the ball, where two maxima are equal, projections onto curves of the
        // analytic functions fail. The large h is therefore tested on samples only.
        for (kind, indicators, h) in
            [("analytic", analytic, 1.5), ("sampled", &sampled, 1.5), ("coarse", &sampled, 2.0)]
        {
            let made = made(&scene, indicators, h, true);
            assert_sound(&made, &format!("{name} {kind}"));
            assert!(
                made.checked.junctions.junction_edges >= junctions,
                "{name}: {}",
                made.checked.junctions.junction_edges
            );
            assert_eq!(made.checked.junctions.junction_edges, made.checked.junctions.segments);
            assert_eq!(made.checked.junctions.junction_points, points, "{name} {kind}");
            let Topology::Materials(pieces) = &made.topology else { panic!("many materials") };
            assert!(pieces.iter().all(|own| own.components == 1 && own.missing.is_empty()));
            assert!(pieces.iter().all(|own| own.euler.map(Some) == [own.mesh_euler; 2]), "{pieces:?}");
        }
    }
}

#[test]
fn materials_end_at_a_plane_with_a_sharp_rim() {
    let (scene, plane) = (scenes::cut(), scenes::plane());
    let errors = |h: f64, keeps_voxels: bool| {
        let materials = scene.sampled(0.5).with_bounds(vec![plane.clone()]);
        let (particles, strata) = scene.particles_on(&materials, h, 0.75);
        let options = Options { keeps_voxels, ..Options::default() };
        let table = materials.table();
        let made = reconstruct((&particles, &strata), &materials, table, None, &options, &Silent).expect("on strata");
        assert_eq!(made.failed, Vec::<String>::new(), "h = {h}");
        if keeps_voxels {
            assert_sound(&made, "cut");
        }
        assert_eq!(made.checked.junctions.junction_edges, made.checked.junctions.segments);
        assert_eq!(made.checked.regions.len(), 3, "the outside and two balls");
        let beyond = MaterialId(3);
        for (triangle, pair) in made.interfaces.mesh.triangles.iter().zip(&made.interfaces.between) {
            assert_ne!(*pair, [beyond, MaterialId::OUTSIDE]);
            let places = triangle.map(|v| made.interfaces.mesh.vertices[v as usize]);
            assert!(pair[1] != beyond || places.iter().all(|p| plane.distance(*p).abs() < 1e-6), "{places:?}");
        }
        let height = |radius: f64| radius + scenes::CUT;
        let volume = |radius: f64| PI * height(radius).powi(2) * (3.0 * radius - height(radius)) / 3.0;
        let area = |id: u16| measure(&made.interfaces.part([MaterialId(id), beyond])).area;
        let [shell, core] = volumes(&made)[..] else { panic!("two") };
        let ratios =
            [core / volume(5.0), shell / (volume(9.0) - volume(5.0)), area(2) / (PI * 16.0), area(1) / (PI * 56.0)];
        ratios.into_iter().map(|ratio| (ratio - 1.0).abs()).fold(0.0, f64::max)
    };
    errors(1.5, true);
    let [coarse, fine] = [2.0, 1.0].map(|h| errors(h, false));
    assert!(coarse < 0.1 && fine < coarse / 3.0, "{coarse} {fine}");
}

#[test]
fn volumes_and_areas_converge_to_second_order() {
    let error = |scene: &Scene, h: f64, truth: &dyn Fn(&Reconstruction) -> f64| {
        let made = made(scene, &scene.analytic, h, false);
        assert_eq!(made.failed, Vec::<String>::new());
        truth(&made)
    };
    let nested = |made: &Reconstruction| {
        let [shell, core] = volumes(made)[..] else { panic!("two") };
        (shell / (ball_volume(9.0) - ball_volume(5.0)) - 1.0).abs().max((core / ball_volume(5.0) - 1.0).abs())
    };
    let sectors = |made: &Reconstruction| {
        let volumes = volumes(made).into_iter().map(|v| (v / (ball_volume(RADIUS) / 3.0) - 1.0).abs());
        // half a disk between any two sectors
        let area = |pair: [u16; 2]| {
            let part = made.interfaces.part(pair.map(MaterialId));
            (measure(&part).area / (0.5 * PI * RADIUS * RADIUS) - 1.0).abs()
        };
        volumes.chain([[2, 1], [3, 1], [3, 2]].map(area)).fold(0.0, f64::max)
    };
    let caps = |made: &Reconstruction| {
        let height = 6.0 + HALF;
        let truth = PI * height * height * (18.0 - height) / 3.0;
        volumes(made).into_iter().map(|v| (v / truth - 1.0).abs()).fold(0.0, f64::max)
    };
    type Error<'a> = &'a dyn Fn(&Reconstruction) -> f64;
    let cases: [(&str, Scene, Error); 3] = [
        ("nested", scenes::nested(), &nested),
        ("sectors", scenes::sectors(), &sectors),
        ("two balls", scenes::two_balls(), &caps),
    ];
    for (name, scene, truth) in cases {
        let [coarse, fine] = [2.0, 1.0].map(|h| error(&scene, h, truth));
        assert!(coarse < 0.07 && fine < coarse / 3.0, "{name}: {coarse} {fine}");
    }
}

#[test]
fn junction_curves_are_exact_and_interfaces_meet_at_120_degrees() {
    let scene = scenes::sectors();
    let made = made(&scene, &scene.analytic, 1.0, true);
    let Interfaces { mesh, between, segments, joined, first_beyond: _ } = &made.interfaces;
    assert!(joined.is_empty(), "no curves are one here");
    let at = |v: u32| mesh.vertices[v as usize] - CENTRE;
    let axis = stratum(&[1, 2, 3]);
    let (mut length, mut count) = (0.0, 0);
    for &([a, b], curve) in segments {
        if curve == axis {
            assert!(at(a).truncate().length().max(at(b).truncate().length()) < 1e-6);
            length += at(a).distance(at(b));
        } else {
            assert!((at(a).length() - RADIUS).abs().max((at(b).length() - RADIUS).abs()) < 1e-6);
        }
    }
    assert!((length - 2.0 * RADIUS).abs() < 1e-6, "{length}");
    for own in made.interfaces.edges().chunk_by(|a, b| a.0 == b.0) {
        let (edge, triangles) = (own[0].0, own.iter().map(|(_, t)| *t).collect::<Vec<u32>>());
        if segments.iter().all(|(pair, curve)| *pair != edge || *curve != axis) {
            continue;
        }
        let tangent = (at(edge[1]) - at(edge[0])).normalize();
        let away = |t: u32| {
            let third = mesh.triangles[t as usize].into_iter().find(|v| !edge.contains(v)).expect("a third");
            let away = at(third) - at(edge[0]);
            (away - away.dot(tangent) * tangent).normalize()
        };
        let ways: Vec<DVec3> = triangles.iter().map(|&t| away(t)).collect();
        assert_eq!(ways.len(), 3);
        for k in 0..3 {
            let angle = ways[k].angle_between(ways[(k + 1) % 3]).to_degrees();
            assert!((angle - 120.0).abs() < 1e-3, "{angle}");
        }
        assert!(triangles.iter().all(|&t| between[t as usize][1] != MaterialId::OUTSIDE));
        count += 1;
    }
    assert!(count >= 16);
}

#[test]
fn neighbours_share_vertices_and_all_volumes_sum_to_zero() {
    let scene = scenes::quarters();
    let made = made(&scene, &scene.analytic, 1.5, true);
    let [one, two] = [1, 2].map(|id| made.interfaces.surface_of(MaterialId(id)).1);
    let shared = one.iter().filter(|v| two.binary_search(v).is_ok()).count();
    assert!(shared > 20, "{shared}");
    let all: f64 = made.checked.regions.iter().map(|own| own.volume).sum();
    assert!(all.abs() < 1e-9, "the outside is the whole turned round: {all}");
}

#[test]
fn the_result_does_not_depend_on_threads() {
    let scene = scenes::sectors();
    let sampled = scene.sampled(1.0);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| made(&scene, &sampled, 2.0, true)).interfaces
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn lost_curve_particles_are_bridged_and_small_loops_get_points() {
    let scene = scenes::two_balls();
    let (mut particles, strata) = scene.particles(1.5, 0.75);
    let count = strata.segments.len();
    particles.positions[3] = DVec3::splat(1.0);
    let prepared = prepare(&particles, &strata, &scene.analytic).expect("on their strata");
    assert_eq!((prepared.report.not_projected, prepared.report.bridged), (1, 1));
    assert_eq!(prepared.segments.count(), count - 1);
    // one or two particles are left on the closed curve
    for left in [1usize, 2] {
        let (particles, mut strata) = scene.particles(1.5, 0.75);
        let keep = |v: usize| strata.of[v].dimension() == 2 || v < left;
        let kept: Vec<usize> = (0..particles.positions.len()).filter(|&v| keep(v)).collect();
        let mut fewer = particles.clone();
        fewer.positions = kept.iter().map(|&v| particles.positions[v]).collect();
        fewer.sizes = kept.iter().map(|&v| particles.sizes[v]).collect();
        strata.of = kept.iter().map(|&v| strata.of[v]).collect();
        strata.segments = if left == 2 { vec![[0, 1], [1, 0]] } else { Vec::new() };
        let options = Options { keeps_voxels: true, ..Options::default() };
        let made = reconstruct((&fewer, &strata), &scene.analytic, &scene.table(), None, &options, &Silent);
        let made = made.expect("on their strata");
        assert!(made.joined().prepared.on_small_loops >= 2, "{}", made.joined().prepared.on_small_loops);
        assert_eq!(made.failed, Vec::<String>::new(), "{left}");
        assert!(made.checked.junctions.junction_edges > 12, "{}", made.checked.junctions.junction_edges);
    }
}

#[test]
fn closed_curve_without_particles_is_found_from_interfaces() {
    let scene = Scene { curves: Vec::new(), ..scenes::two_balls() };
    // the spline through samples has no kinks on the curve
    let made = made(&scene, &scene.sampled(1.0), 1.5, false);
    assert_eq!((made.joined().prepared.loops_added, &made.failed), (1, &Vec::new()));
    assert!(made.checked.junctions.junction_edges > 12, "{}", made.checked.junctions.junction_edges);
}

#[test]
fn layer_of_a_fifth_of_h_stays_whole_with_few_added_points() {
    let scene = scenes::shell(9.0, 8.7);
    let made = made(&scene, &scene.analytic, 1.5, false);
    assert_eq!(made.failed, Vec::<String>::new());
    let (points, added) = (made.interfaces.mesh.vertices.len(), made.joined().refined.inserted.values().sum::<usize>());
    assert!(added * 50 < points, "{added} of {points}");
}

#[test]
fn two_curves_between_two_junction_points_are_distinguished() {
    // two balls touch in a strip between two half spaces, and are separate beyond its ends
    let (far, sag): (f64, f64) = (30.0, 0.1);
    let half_length = ((far + sag).powi(2) - far.powi(2)).sqrt();
    let functions = vec![
        half_space(CENTRE, DVec3::X),
        half_space(CENTRE, -DVec3::X),
        ball(CENTRE - DVec3::Y * far, far + sag),
        ball(CENTRE + DVec3::Y * far, far + sag),
    ];
    let analytic = Analytic::new(functions, 1.0);
    let ends = [-1.0, 1.0].map(|side| (vec![0, 1, 2, 3], CENTRE + DVec3::Z * side * half_length));
    let interfaces = [(vec![0, 2], DVec3::new(-3.0, -3.0, 0.0)), (vec![1, 3], DVec3::new(3.0, 3.0, 2.0))]
        .map(|(ids, from)| (ids, CENTRE + from));
    for (wall, other) in [(0, 1), (1, 0)] {
        let side = if wall == 0 { -1.0 } else { 1.0 };
        let middle = (vec![wall, 2, 3], CENTRE + DVec3::X * side * sag);
        let all: Vec<(Vec<u16>, DVec3)> = ends.iter().cloned().chain([middle]).chain(interfaces.clone()).collect();
        let prepared = prepared_of(&all, vec![[0, 2], [2, 1], [0, 1]], &analytic);
        assert_eq!(prepared.segments.count(), 3);
        assert_eq!(prepared.segments.curve([0, 1]), Some(stratum(&[other, 2, 3])), "the other beside {wall}");
    }
}

#[test]
fn junction_points_far_closer_than_h_keep_their_curves() {
    // Voronoi cells of five sites: one above, one below, and three around the middle. The two
    // points where four cells meet lie `half` above and below the middle.
    let (half, up): (f64, f64) = (0.015, 5.0);
    let round = (up * up - 2.0 * half * up).sqrt();
    let turned = |thirds: f64| DVec3::new((thirds * 2.0 * PI / 3.0).cos(), (thirds * 2.0 * PI / 3.0).sin(), 0.0);
    let site = |place: DVec3| ball(CENTRE + place, 1.0);
    let mut functions = vec![site(DVec3::Z * up)];
    functions.extend((0..3u8).map(|n| site(round * turned(f64::from(n)))));
    functions.push(site(-DVec3::Z * up));
    let analytic = Analytic::new(functions, 1.0);
    let ends = [(0, 1.0), (4, -1.0)];
    let mut all: Vec<(Vec<u16>, DVec3)> =
        ends.iter().map(|&(id, side)| (vec![id, 1, 2, 3], CENTRE + DVec3::Z * side * half)).collect();
    let mut pairs = vec![[0, 1]];
    for (end, (id, side)) in (0..).zip(ends) {
        for n in 0..3u16 {
            // one millimetre along the curve, between two of the three sites
            pairs.push([end, all.len() as u32]);
            let place = turned(f64::from(n) + 0.5) + DVec3::Z * side * (half + 0.5 * round / up);
            all.push((vec![id, n + 1, (n + 1) % 3 + 1], CENTRE + place));
        }
    }
    let prepared = prepared_of(&all, pairs, &analytic);
    assert_eq!(prepared.strata[..2], [stratum(&[0, 1, 2, 3]), stratum(&[1, 2, 3, 4])]);
    assert_eq!(prepared.segments.curve([0, 1]), Some(stratum(&[1, 2, 3])));
    assert!((0..2).all(|end| prepared.segments.at(end).count() == 4));
}

#[test]
fn curves_far_closer_than_h_keep_their_points() {
    // two balls cut by a plane, on which their circles are 0.03 mm apart
    let (radius, half) = (3.0, 0.015);
    let centre = |side: f64| CENTRE + DVec3::X * side * (radius + half);
    let [low, high] = [DVec3::Z, -DVec3::Z].map(|outwards| half_space(CENTRE, outwards));
    let analytic = Analytic::new(vec![low, high, ball(centre(-1.0), radius), ball(centre(1.0), radius)], 1.0);
    let (mut all, mut pairs) = (Vec::new(), Vec::new());
    for (id, side) in [(2, -1.0), (3, 1.0)] {
        for n in 0..4u32 {
            pairs.push([all.len() as u32, all.len() as u32 - n + (n + 1) % 4]);
            let (sin, cos) = (f64::from(n) * 0.5 * PI).sin_cos();
            all.push((vec![0, 1, id], centre(side) + radius * DVec3::new(-side * cos, sin, 0.0)));
        }
    }
    // one point off the plane
    all.push((vec![0, 2], centre(-1.0) - DVec3::Z * 0.5 * radius));
    let prepared = prepared_of(&all, pairs, &analytic);
    assert_eq!(prepared.segments.count(), 8);
    assert_eq!((0..8).map(|v| prepared.segments.at(v).count()).collect::<Vec<_>>(), [2; 8]);
    assert_eq!(prepared.report.crowded, 0);
}

/// Returns two materials on either side of a ribbon, on which the materials above and below it
/// touch. The width of the ribbon is twice `half` (mm).
fn ribbon(half: f64) -> Analytic {
    let wedge = |side: f64| half_space(CENTRE + DVec3::X * side * half, -DVec3::X * side);
    let [low, high] = [DVec3::Z, -DVec3::Z].map(|outwards| half_space(CENTRE, outwards));
    Analytic::new(vec![low, high, wedge(-1.0), wedge(1.0)], 1.0)
}

/// Returns the complex refined from points one millimetre apart on the two curves along the ribbon.
/// The points of one curve are shifted along it relative to those of the other.
fn refined_ribbon(analytic: &Analytic, half: f64) -> Complex<'_> {
    let (mut all, mut pairs) = (Vec::new(), Vec::new());
    for (id, side, offset) in [(2, -1.0, 0.0), (3, 1.0, 0.37)] {
        for n in 0..9 {
            if n > 0 {
                pairs.push([all.len() as u32 - 1, all.len() as u32]);
            }
            let along = DVec3::Y * (f64::from(n) - 4.0 + offset);
            all.push((vec![0, 1, id], CENTRE + DVec3::X * side * half + along));
        }
    }
    for (id, side) in [(2, -1.0), (3, 1.0)] {
        for (n, away) in (0..9).flat_map(|n| [(n, 0.7), (n, 1.4)]) {
            let along = DVec3::Y * (f64::from(n) - 3.9 + 0.5 * away);
            let place = |up: f64| CENTRE + along + DVec3::X * side * (half + away) + DVec3::Z * up * away;
            all.extend([(vec![0, id], place(-1.0)), (vec![1, id], place(1.0))]);
        }
    }
    let prepared = prepared_of(&all, pairs, analytic);
    assert_eq!(prepared.segments.count(), 16);
    let mut refinement =
        Refinement::new(Complex::new(prepared, analytic, DVec3::splat(24.0), &Options::default()), None);
    // the interfaces beyond the ends of the curves have no curves, and their refinement takes long
    let enough = |points: usize| if points < 600 { Ok(()) } else { Err(Error::input("enough points", "", "")) };
    let outcome = refinement.drain([], &mut { enough });
    assert!(outcome.is_ok() || refinement.complex.points().len() >= 600, "{outcome:?}");
    refinement.complex
}

/// Returns the curves of the segments away from the ends of a ribbon, where points surround them.
/// All of these segments must be right.
fn inner_curves(complex: &Complex) -> Vec<Stratum> {
    let is_inner = |v: &u32| (complex.points()[*v as usize] - CENTRE).y.abs() < 3.2;
    let inner = complex.segments.all().filter(|(pair, _)| pair.iter().all(is_inner));
    let (wrong, right): (Vec<_>, Vec<_>) = inner.partition(|(pair, _)| complex.is_wrong(Simplex::Edge(*pair)));
    assert!(wrong.is_empty(), "{wrong:?}");
    right.into_iter().map(|(_, curve)| curve).collect()
}

#[test]
fn close_parallel_curves_get_points_in_pairs() {
    let half = 0.04;
    let analytic = ribbon(half);
    let curves = inner_curves(&refined_ribbon(&analytic, half));
    // each of twelve segments is split once or twice, not down to the width of the ribbon
    assert!((12..=36).contains(&curves.len()), "{}", curves.len());
    assert!(curves.iter().all(|curve| curve.dimension() == 1), "{curves:?}");
}

#[test]
fn inserted_ball_centre_removes_its_facet() {
    // six corners on a ball; the dual Voronoi edges of the facets cross the ball far from the
    // facets
    let analytic = Analytic::new(vec![negative(ball(CENTRE, RADIUS)), ball(CENTRE, RADIUS)], 1.0);
    let mut all: Vec<(Vec<u16>, DVec3)> = Vec::new();
    for [x, y, z] in
        [[1.0, 0.0, 0.1], [0.0, 1.0, 0.0], [-1.0, 0.1, 0.0], [0.1, -1.0, 0.0], [0.2, 0.1, 1.0], [0.0, 0.2, -1.0]]
    {
        all.push((vec![0, 1], CENTRE + RADIUS * DVec3::new(x, y, z).normalize()));
    }
    let complex =
        || Complex::new(prepared_of(&all, Vec::new(), &analytic), &analytic, DVec3::splat(24.0), &Options::default());
    let facets = complex().labelled.facets();
    assert_eq!(facets.len(), 8);
    for facet in facets {
        let mut complex = complex();
        let place = complex.ball(&facet).expect("on its interface").place;
        complex.labelled.insert(place, facet.vertices[0]).expect("in the volume").expect("new");
        complex.strata.push(stratum(&[0, 1]));
        complex.sizes.push(1.0);
        complex.decide();
        assert!(complex.facet_on(facet.sorted()).is_none(), "{facet:?} is still there");
    }
}

/// Prepares points at the given positions on the given strata, with h = 1 mm.
fn prepared_of(all: &[(Vec<u16>, DVec3)], segments: Vec<[u32; 2]>, indicators: &dyn Indicators) -> Prepared {
    let count = all.len();
    let particles = ParticleSet {
        geometry: Geometry::axis_aligned([25; 3], DVec3::ONE),
        positions: all.iter().map(|(_, place)| *place).collect(),
        normals: vec![DVec3::ZERO; count],
        sizes: vec![1.0; count],
        energies: vec![0.0; count],
        lambdas: vec![0.1; count],
    };
    let of = all.iter().map(|(ids, _)| stratum(ids)).collect();
    prepare(&particles, &Strata { of, segments }, indicators).expect("on their strata")
}

/// Removes the triangles whose materials do not satisfy a condition.
fn retain(interfaces: &mut Interfaces, is_kept: impl Fn([MaterialId; 2]) -> bool) {
    let Interfaces { mesh, between, .. } = interfaces;
    let mut own = between.iter();
    mesh.triangles.retain(|_| own.next().is_some_and(|&between| is_kept(between)));
    between.retain(|&between| is_kept(between));
}

#[test]
fn each_kind_of_damage_fails_its_check() {
    let scene = scenes::sectors();
    let made = made(&scene, &scene.analytic, 1.5, true);
    let nodes = Nodes::new(&scene.geometry(1.0), &scene.analytic);
    let table = scene.table();
    let subject = Materials { indicators: &scene.analytic, nodes: &nodes, table: &table };
    let options = CheckOptions {
        subject: Some(&subject),
        keeps_nodes: true,
        min_radius_ratio: Some(0.3),
        max_vertex_distance: Some(1e-4),
        ..CheckOptions::default()
    };
    let failed = |damage: &dyn Fn(&mut Interfaces)| {
        let mut interfaces = made.interfaces.clone();
        damage(&mut interfaces);
        let checked = check(&interfaces, &options);
        let compared = subject.compare(&interfaces.mesh, &checked);
        [checked.failed, compared.failed].concat().join("; ")
    };
    assert_eq!(failed(&|_| {}), "");
    let plain = |i: &Interfaces| {
        let meets = i.materials_at_vertices();
        i.mesh
            .triangles
            .iter()
            .position(|t| t.iter().all(|&v| meets[v as usize].len() == 2))
            .expect("inside a interface")
    };
    type Damage<'a> = &'a dyn Fn(&mut Interfaces);
    let damages: [(&str, Damage); 9] = [
        ("open edges", &|i| {
            i.mesh.triangles.pop();
            i.between.pop();
        }),
        ("opposite orientation", &|i| {
            let t = plain(i);
            i.mesh.triangles[t].swap(0, 1);
        }),
        ("not edges between their materials", &|i| {
            i.segments.push(([0, i.mesh.vertices.len() as u32 - 1], stratum(&[1, 2, 3])))
        }),
        ("away from junction curves", &|i| i.segments.truncate(i.segments.len() - 1)),
        ("intersecting triangles", &|i| {
            let v = i.mesh.triangles[plain(i)][0];
            i.mesh.vertices[v as usize] = CENTRE - 0.6 * (i.mesh.vertices[v as usize] - CENTRE);
        }),
        ("from the interface", &|i| {
            let v = i.mesh.triangles[plain(i)][0];
            i.mesh.vertices[v as usize] += DVec3::splat(0.01);
        }),
        ("below 0.3", &|i| {
            let [a, b, _] = i.mesh.triangles[plain(i)];
            i.mesh.vertices[a as usize] = i.mesh.vertices[a as usize].lerp(i.mesh.vertices[b as usize], 0.9);
        }),
        ("on the wrong side of the mesh", &|i| {
            i.mesh.vertices.iter_mut().for_each(|p| *p = CENTRE + 0.8 * (*p - CENTRE))
        }),
        ("missing components of materials", &|i| {
            let whole = MaterialId(1);
            for between in &mut i.between {
                *between = between.map(|id| if id.0 > 1 { whole } else { id });
            }
            retain(i, |[inside, outside]| inside != outside);
        }),
    ];
    for (what, damage) in damages {
        let found = failed(damage);
        assert!(found.contains(what), "{what}: {found}");
    }
}

#[test]
fn a_lost_cavity_changes_the_euler_characteristic() {
    let scene = scenes::nested();
    let made = made(&scene, &scene.analytic, 2.0, false);
    let nodes = Nodes::new(&scene.geometry(1.0), &scene.analytic);
    let table = scene.table();
    let subject = Materials { indicators: &scene.analytic, nodes: &nodes, table: &table };
    let doubts = |interfaces: &Interfaces| {
        let options = CheckOptions { subject: Some(&subject), ..CheckOptions::default() };
        subject.compare(&interfaces.mesh, &check(interfaces, &options)).doubtful.join("; ")
    };
    assert_eq!(doubts(&made.interfaces), "");
    let (core, shell) = (MaterialId(2), MaterialId(1));
    let mut solid = made.interfaces.clone();
    retain(&mut solid, |between| !between.contains(&core));
    let found = doubts(&solid);
    assert!(found.contains(&format!("{} 2 instead of 4", table[shell.index()].name)), "{found}");
}

#[test]
fn a_reversed_interface_is_one_inward_component() {
    let scene = scenes::nested();
    let made = made(&scene, &scene.analytic, 2.0, false);
    let nodes = Nodes::new(&scene.geometry(1.0), &scene.analytic);
    let options = CheckOptions {
        subject: Some(&Materials { indicators: &scene.analytic, nodes: &nodes, table: &[] }),
        ..CheckOptions::default()
    };
    let mut reversed = made.interfaces.clone();
    let core = reversed.between.iter().map(|between| between[1] != MaterialId::OUTSIDE);
    reversed.mesh.triangles.iter_mut().zip(core).filter(|(_, is_core)| *is_core).for_each(|(t, _)| t.swap(0, 1));
    assert_eq!(check(&reversed, &options).failed, ["1 components with inward normals"]);
}

#[test]
fn triangles_forced_by_curves_fail_unless_accepted() {
    let scene = scenes::quarters();
    let made = made(&scene, &scene.analytic, 3.0, true);
    let nodes = Nodes::new(&scene.geometry(1.0), &scene.analytic);
    let table = scene.table();
    let subject = Materials { indicators: &scene.analytic, nodes: &nodes, table: &table };
    let checked = |accept_forced: bool| {
        let options = CheckOptions {
            subject: Some(&subject),
            keeps_nodes: true,
            min_radius_ratio: Some(1.0),
            max_vertex_distance: Some(1e-4),
            accept_forced,
            ..CheckOptions::default()
        };
        check(&made.interfaces, &options)
    };
    let [strict, accepting] = [false, true].map(checked);
    let count = strict.poor_between_curves.len();
    assert!(count > 0, "{:?}", strict.quality);
    assert!(strict.poor_between_curves.is_sorted_by_key(|t| t.radius_ratio));
    assert_eq!([&strict, &accepting].map(|report| report.count(Fault::ForcedTriangles)), [count, 0]);
    let said = format!("{count} poor triangles forced by the junction curves");
    let told = |report: &CheckReport| report.failed.iter().filter(|text| text.contains(&said)).count();
    assert_eq!((told(&strict), told(&accepting)), (1, 0), "{:?}", strict.failed);
    let words = strict.failed.iter().find(|text| text.contains(&said)).expect("counted");
    let at = place(strict.poor_between_curves[0].place);
    for part in [&format!("at {at} mm"), "SCALE", "--accept-forced"] {
        assert!(words.contains(part), "{words}");
    }
}
