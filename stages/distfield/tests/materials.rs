//! Tests volumes with several materials: the materials of voxel centres, contacts, areas and
//! volumes, scales, the output file and the program.

mod support;

use glam::DVec3;
use isoparticles_distfield::Border;
use isoparticles_distfield::materials::choice::resolve;
use isoparticles_distfield::materials::contacts::ContactReport;
use isoparticles_distfield::materials::scales::Scales;
use isoparticles_distfield::materials::survey::{Survey, survey};
use isoparticles_distfield::materials::{Extracted, LabelGrid, MaterialChoice, MaterialOptions, extract};
use isoparticles_distfield::scale::Scale;
use isoparticles_field::materials::{Analytic, Indicators, MaterialId, ball, maximum, negative};
use isoparticles_field::random::uniform;
use isoparticles_field::spline::CubicSpline;
use isoparticles_stage::field_file::{FieldKind, read_field};
use isoparticles_stage::material_sizes::Given;
use isoparticles_stage::materials_file::read_materials;
use isoparticles_stage::monitor::Silent;
use isoparticles_tests::nrrd;
use isoparticles_tests::skip::real_volume;
use isoparticles_volume::{Geometry, Volume, Voxels, read_volume};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const MARGIN: usize = 5;
const OPTIONS: MaterialOptions = MaterialOptions { clearance: 0.05, scales: None };

struct Made {
    grid: LabelGrid,
    extracted: Extracted,
    survey: Survey,
}

fn make(volume: Volume, border: Border) -> Made {
    make_with(volume, border, OPTIONS)
}

fn make_with(volume: Volume, border: Border, options: MaterialOptions) -> Made {
    let chosen = resolve(&[MaterialChoice::All], &volume).expect("labels");
    let grid = LabelGrid::new(&volume, &chosen, border, MARGIN);
    let extracted = extract(&grid, &chosen, &options, &Silent).expect("indicators");
    let materials = &extracted.materials;
    let survey = survey(materials, materials.geometry(), &grid, chosen.table.len(), &[], &Silent).expect("surveyed");
    Made { grid, extracted, survey }
}

fn volume(size: [usize; 3], label: impl Fn([usize; 3]) -> u8) -> Volume {
    let geometry = Geometry::axis_aligned(size, DVec3::new(1.0, 0.8, 1.3));
    let at = |n: usize| [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
    let labels = (0..geometry.voxel_count()).map(|n| label(at(n))).collect();
    Volume::new(geometry, Voxels::U8(labels))
}

impl Made {
    /// Checks the indicators known at each node: only the indicator of the node's material is
    /// negative, and all absolute values are at least the clearance. The survey must agree.
    fn keeps_every_voxel(&self, what: &str) {
        let materials = &self.extracted.materials;
        let geometry = materials.geometry();
        let [nx, ny, _] = geometry.size;
        let least = 0.0499 * geometry.min_spacing();
        for n in 0..geometry.voxel_count() {
            let node = [n % nx, n / nx % ny, n / (nx * ny)];
            let own = self.grid.at(node);
            // beyond an open border, interfaces continue straight, but the nodes have no labels
            let is_voxel = (0..3).all(|a| (MARGIN..geometry.size[a] - MARGIN).contains(&node[a]));
            if self.grid.border == Border::Open && !is_voxel {
                continue;
            }
            let near = materials.near(geometry.index_to_grid(DVec3::from_array(node.map(|n| n as f64))));
            assert_eq!(near.first(), Some(own), "{what} at {node:?}: {near:?}");
            for &(id, value) in near.entries() {
                assert_eq!(value < 0.0, id == own, "{what} at {node:?}: {near:?}");
                assert!(value.abs() >= least, "{what} at {node:?}: {near:?}");
            }
            assert_eq!(self.survey.material[n], own.0);
        }
        assert!(self.survey.changed.iter().all(|&count| count == 0), "{what}");
        for (tally, material) in self.extracted.tallies.iter().zip(materials.table()) {
            assert_eq!(tally.changed, 0, "{what}: {material:?}");
            // where every cell is ambiguous, rounding decides the number of parts
            if ["checkerboard", "noise", "brain"].iter().any(|hard| what.contains(hard)) {
                continue;
            }
            let [before, after] = tally.parts;
            assert_eq!(
                (before.components, before.cavities),
                (after.components, after.cavities),
                "{what}: {material:?}"
            );
        }
    }

    /// Checks the midpoints of grid edges, faces and cells: a corner must have the material with
    /// the smallest indicator, and on edges, the two smallest indicators must belong to the
    /// materials of the two ends. Returns the number of edges between two materials, of such edges
    /// near which the indicator of a third material is stored, of faces on which the ends of every
    /// edge have different materials, and of such faces where the maximum indicators of the two
    /// diagonals differ by less than 0.1 voxel.
    fn keeps_contacts(&self, what: &str) -> [usize; 4] {
        let materials = &self.extracted.materials;
        let geometry = materials.geometry();
        let (mut counts, mut wrong) = ([0; 4], 0);
        for axes in 1..8usize {
            let last: [usize; 3] = std::array::from_fn(|a| geometry.size[a] - (axes >> a & 1));
            for n in 0..last.iter().product::<usize>() {
                let node = [n % last[0], n / last[0] % last[1], n / (last[0] * last[1])];
                let corner = |corner: usize| self.grid.at(std::array::from_fn(|a| node[a] + (corner >> a & 1)));
                let corners: Vec<MaterialId> = (0..8).filter(|n| n & !axes == 0).map(corner).collect();
                let is_voxel = (0..3).all(|a| (MARGIN..geometry.size[a] - MARGIN - 1).contains(&node[a]));
                if self.grid.border == Border::Open && !is_voxel {
                    continue;
                }
                if corners.iter().all(|&id| id == corners[0]) {
                    continue;
                }
                let middle = std::array::from_fn(|a| node[a] as f64 + 0.5 * (axes >> a & 1) as f64);
                let near = materials.near(geometry.index_to_grid(DVec3::from_array(middle)));
                let first: Vec<MaterialId> = near.entries().iter().map(|(id, _)| *id).collect();
                let two = if corners.len() == 2 { &first[..2] } else { &first[..1] };
                if !two.iter().all(|id| corners.contains(id)) {
                    println!("{what}: {corners:?} at {middle:?}: {near:?}");
                    wrong += 1;
                }
                match corners[..] {
                    [_, _] => {
                        counts[0] += 1;
                        counts[1] += usize::from(first.len() > 2);
                    }
                    [a, b, c, d] if a != b && b != d && d != c && c != a => {
                        let value =
                            |id| materials.value_gradient(id, geometry.index_to_grid(DVec3::from_array(middle))).0;
                        let gap = value(a).max(value(d)) - value(b).max(value(c));
                        counts[2] += 1;
                        counts[3] += usize::from(gap.abs() < 0.1 * geometry.mean_spacing());
                    }
                    _ => {}
                }
            }
        }
        let ContactReport { left, near, .. } = self.extracted.contacts;
        assert!(wrong <= left && near >= counts[3], "{what}: {wrong}, {left} left, {near} near, {counts:?}");
        // with random labels, a few wrong midpoints remain and are reported
        assert!(left == 0 || what.contains("noise") && left < 10, "{what}: {left} left");
        counts
    }
}

#[test]
fn every_voxel_centre_keeps_its_material() {
    let within = |at: [usize; 3], low: usize, high: usize| at.iter().all(|n| (low..high).contains(n));
    type Labels = Box<dyn Fn([usize; 3]) -> u8>;
    let cases: [(&str, Labels); 7] = [
        (
            "an edge only",
            Box::new(move |[i, j, k]| match (i < 6, j < 6) {
                _ if !within([i, j, k], 2, 10) => 0,
                (true, true) => 1,
                (false, false) => 2,
                _ => 0,
            }),
        ),
        (
            "a corner only",
            Box::new(move |[i, j, k]| match [i < 6, j < 6, k < 6] {
                _ if !within([i, j, k], 2, 10) => 0,
                [true, true, true] => 1,
                [false, false, false] => 2,
                _ => 0,
            }),
        ),
        (
            "two that alternate",
            Box::new(move |[i, j, k]| match (i < 6) == (j < 6) {
                _ if !within([i, j, k], 2, 10) => 0,
                true => 1,
                false => 2,
            }),
        ),
        (
            "eight in a block",
            Box::new(move |[i, j, k]| {
                let octant = u8::from(i < 6) + 2 * u8::from(j < 6) + 4 * u8::from(k < 6);
                if within([i, j, k], 2, 10) { 1 + octant } else { 0 }
            }),
        ),
        (
            "a layer of one voxel and an island of one",
            Box::new(|[i, j, k]| match (i, j, k) {
                (3, 4, 9) => 4,
                (_, _, 5) => 2,
                (_, _, 0..5) => 1,
                _ => 3,
            }),
        ),
        ("a checkerboard", Box::new(|[i, j, k]| 1 + ((i / 2 + j / 2 + k / 2) % 2) as u8)),
        ("noise", Box::new(|[i, j, k]| (4.0 * uniform(3, 0, (i + 12 * (j + 12 * k)) as u64)) as u8)),
    ];
    for (what, label) in cases {
        for border in [Border::Cap, Border::Open] {
            let made = make(volume([12; 3], &label), border);
            made.keeps_every_voxel(&format!("{what}, {border:?}"));
            let [_, _, open, narrow] = made.keeps_contacts(what);
            // in a checkerboard, every raise makes further raises necessary, so more margins stay
            // too small
            let most = if what == "a checkerboard" { open / 3 } else { open / 20 };
            assert!(narrow <= most, "{what}: {narrow} of {open}");
            if what == "two that alternate" {
                assert!(open >= 8 && made.survey.junctions.edges_of_three > 0);
            }
            if what == "eight in a block" {
                assert!(made.survey.junctions.edges_of_four >= 24 && made.survey.junctions.corners >= 7);
            }
            // the total volume is preserved: one material loses what another gains
            let voxel = made.grid.geometry.spacing.element_product();
            let sum: f64 = made.survey.volumes.iter().sum();
            assert!((sum / (1728.0 * voxel) - 1.0).abs() < 1e-9, "{what}: {sum}");
        }
    }
}

#[test]
fn a_thin_layer_stays() {
    let layer = |[_, _, k]: [usize; 3]| match k {
        7 => 2,
        0..7 => 1,
        _ => 3,
    };
    let made = make(volume([14; 3], layer), Border::Open);
    // lower limit of the volume: the layer is at least 0.6 voxel thick on average
    let thin = 14.0 * 14.0 * 1.0 * 0.8 * 0.6 * 1.3;
    assert!(made.survey.volumes[2] > thin, "{} of {thin}", made.survey.volumes[2]);
    let pairs: Vec<_> = made.survey.interfaces.iter().map(|pair| pair.materials.map(|id| id.0)).collect();
    assert_eq!(pairs, [[1, 2], [2, 3]]);
    for pair in &made.survey.interfaces {
        assert!((pair.area / (13.0 * 13.0 * 0.8) - 1.0).abs() < 0.16, "{pair:?}");
    }
}

/// Returns the maximum relative error of the interface areas of two nested balls, and the relative
/// error of the volume of the inner ball. `spacing` is the voxel spacing, mm.
fn nested_errors(spacing: f64) -> (f64, f64) {
    let nodes = (24.0 / spacing) as usize + 1;
    let geometry = Geometry::axis_aligned([nodes; 3], DVec3::splat(spacing));
    let centre = DVec3::new(12.1, 11.8, 12.3);
    let shell = maximum(ball(centre, 9.0), negative(ball(centre, 5.0)));
    let balls = Analytic::new(vec![negative(ball(centre, 9.0)), shell, ball(centre, 5.0)], spacing);
    let place = |n: usize| DVec3::new((n % nodes) as f64, (n / nodes % nodes) as f64, (n / (nodes * nodes)) as f64);
    let numbers = (0..nodes.pow(3)).map(|n| balls.material_at(spacing * place(n)).0).collect();
    let grid = LabelGrid { geometry: geometry.clone(), numbers, border: Border::Cap, margin: 0 };
    let found = survey(&balls, &geometry, &grid, 3, &[], &Silent).expect("surveyed");
    let area = |pair: usize, radius: f64| {
        (found.interfaces[pair].area / (4.0 * std::f64::consts::PI * radius * radius) - 1.0).abs()
    };
    let volume = found.volumes[2] / (4.0 / 3.0 * std::f64::consts::PI * 125.0) - 1.0;
    (area(0, 9.0).max(area(1, 5.0)), volume.abs())
}

#[test]
fn areas_and_volumes_converge() {
    let (coarse, fine) = (nested_errors(1.0), nested_errors(0.25));
    assert!(coarse.0 < 0.02 && fine.0 < 0.002, "areas {coarse:?} {fine:?}");
    assert!(coarse.1 < 0.02 && fine.1 < 0.001, "volumes {coarse:?} {fine:?}");
}

/// Returns a volume with a ball that is divided into three sectors around the z axis (labels 1 to
/// 3), and a separate block of eight voxels of label 4.
fn sectors(size: usize, radius: f64) -> Volume {
    let centre = 0.5 * (size as f64 - 1.0) + 0.13;
    volume([size; 3], |at| {
        let [x, y, z] = at.map(|n| n as f64 - centre);
        let (x, y, z) = (x, 0.8 * y, 1.3 * z);
        if at.iter().all(|n| (2..4).contains(n)) {
            return 4;
        }
        let turn = (y.atan2(x) / std::f64::consts::TAU + 0.6).rem_euclid(1.0);
        if x * x + y * y + z * z < radius * radius { 1 + (3.0 * turn) as u8 % 3 } else { 0 }
    })
}

fn scaled(volume: Volume, length: f64) -> Made {
    make_with(
        volume,
        Border::Cap,
        MaterialOptions { scales: Some(Scales::same(Scale { length, keep_thin: false })), ..OPTIONS },
    )
}

/// Returns the root-mean-square angle (degrees) between the normals of the outer border of
/// [`sectors`] (size 40, radius 10.5) and the radial direction. Includes only sectors that
/// `is_meant` selects, away from their edges. Fails if the border is more than 0.4 mm from the
/// ball.
fn roughness(made: &Made, is_meant: impl Fn(u16) -> bool) -> f64 {
    let materials = &made.extracted.materials;
    let centre = materials.geometry().index_to_grid(DVec3::splat(0.5 * 39.0 + 0.13 + MARGIN as f64));
    let (mut sum, mut count, mut farthest) = (0.0, 0.0, 0.0f64);
    for n in 0..400 {
        let way = DVec3::new(uniform(9, 0, n), uniform(9, 1, n), uniform(9, 2, n)) - 0.5;
        let start = centre + way.normalize() * 10.5;
        let near = materials.near(start);
        let [(a, _), (b, _), ..] = near.entries() else { panic!("one material at {start}") };
        let Some(p) = materials.project_onto_interface([*a, *b], start, 2.0, 1e-6) else { continue };
        if a.0 * b.0 == 0 && is_meant(a.0 + b.0) && materials.clearance(p, &[*a, *b]) > 3.0 {
            let normal = materials.difference_gradient(*a, *b, p).1.normalize();
            sum += normal.cross((p - centre).normalize()).length_squared();
            farthest = farthest.max((p.distance(centre) - 10.5).abs());
            count += 1.0;
        }
    }
    assert!(count > 50.0 && farthest < 0.4, "{count} {farthest}");
    (sum / count).sqrt().to_degrees()
}

#[test]
fn a_scale_keeps_the_volumes_of_all_and_smooths_their_borders() {
    let (made, kept) = (scaled(sectors(40, 10.5), 5.0), make(sectors(40, 10.5), Border::Cap));
    for id in 0..4 {
        let change = made.survey.volumes[id] / (made.extracted.tallies[id].voxels as f64 * 1.04) - 1.0;
        assert!(change.abs() < 0.025, "{id}: {change}");
        assert!(made.extracted.tallies[id].changes.as_ref().is_some_and(|changes| changes.voxels_changed > 0));
    }
    // the small block has vanished, and its voxels belong to the outside
    assert_eq!((made.survey.volumes[4], kept.extracted.tallies[4].voxels), (0.0, 8));
    assert!(made.extracted.tallies[4].changes.is_none());
    // With the scale, the normals of the border are nearly radial; without the scale, they show
    // voxel steps. The edges of the sectors are rounded, and the border next to the edges
    // compensates for this.
    let rough = |made: &Made| roughness(made, |_| true);
    let labels = sectors(40, 10.5).voxels.to_f32();
    let ball = volume([40; 3], |[i, j, k]| u8::from(labels[(k * 40 + j) * 40 + i] > 0.0));
    let [smooth, stepped, one] = [&made, &kept, &scaled(ball, 5.0)].map(rough);
    assert!(smooth < 0.6 * stepped && smooth < 2.0 * one, "{smooth} {stepped} {one}");
    // the three sectors still meet on the axis
    let materials = &made.extracted.materials;
    let axis = materials.geometry().index_to_grid(DVec3::splat(0.5 * 39.0 + 0.13 + MARGIN as f64));
    let own = [1, 2, 3].map(MaterialId);
    for z in [-6.0, 0.0, 6.0] {
        let p = materials.project_onto_curve(own, axis + DVec3::new(0.4, -0.3, z), 2.0, 1e-6).expect("near the axis");
        assert!((p - axis).truncate().length() < 0.2 && materials.clearance(p, &own) > 0.0, "{}", p - axis);
    }
}

#[test]
fn parts_larger_than_their_own_scale_are_kept_beside_coarser_ones() {
    // two balls of label 2 in label 1, with radii of 7 and 4 mm (1437 and 268 mm^3); at a scale of
    // 16 mm, both would be removed as too small, but label 2 has a shorter scale
    let balls = volume([44, 40, 30], |at| {
        let p = DVec3::from_array(at.map(|n| n as f64)) * DVec3::new(1.0, 0.8, 1.3);
        let is_in = |x: f64, radius: f64| p.distance(DVec3::new(x, 16.0, 19.5)) < radius;
        if is_in(12.0, 7.0) || is_in(32.0, 4.0) { 2 } else { 1 }
    });
    let names = ["outside", "1", "2"].map(str::to_owned);
    let given = Given::new(&["2=2".parse().expect("a size")], &names).expect("a material");
    let own = Scales::new(Scale { length: 16.0, keep_thin: false }, given, 1.01).expect("scales");
    let made = make_with(balls, Border::Cap, MaterialOptions { scales: Some(own), ..OPTIONS });
    assert_eq!(made.extracted.tallies[2].parts.map(|parts| parts.components), [2, 2]);
    let change = made.survey.volumes[2] / (made.extracted.tallies[2].voxels as f64 * 1.04) - 1.0;
    assert!(change.abs() < 0.05, "{change}");
}

#[test]
fn a_volume_of_islands_only_is_outside_at_a_scale() {
    let folder = tempfile::tempdir().expect("folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("text").to_owned();
    let (input, output) = (at("in.nrrd"), at("out.vti"));
    let labels = nrrd::Voxels::U8((0..16 * 16 * 16).map(|n| u8::from(n == 2184)).collect());
    let geometry = Geometry::axis_aligned([16; 3], DVec3::ONE);
    nrrd::write(Path::new(&input), &geometry, nrrd::FileSpace::Lps, &labels, true).expect("written");
    let words = ["--material", "s=1", "--scale", "3", "--smallest-island", "100"];
    let run = distfield(&[&[&input, "-o", &output][..], &words].concat());
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.code().is_some_and(|code| code < 3) && !said.contains("panicked"), "{said}");
}

#[test]
fn specks_do_not_fill_gaps_between_materials_at_a_scale() {
    // single voxels of label 5 on the axis where the three sectors meet; they must not grow
    let with_specks = || {
        let labels = sectors(40, 10.5).voxels.to_f32();
        volume([40; 3], |[i, j, k]| {
            let is_speck = (i, j) == (20, 20) && k % 4 == 0 && k > 12 && k < 28;
            if is_speck { 5 } else { labels[(k * 40 + j) * 40 + i] as u8 }
        })
    };
    for keep_thin in [false, true] {
        let scales = Some(Scales::same(Scale { length: 5.0, keep_thin }));
        let made = make_with(with_specks(), Border::Cap, MaterialOptions { scales, ..OPTIONS });
        let [speck, before] = [made.survey.volumes[5], made.extracted.tallies[5].voxels as f64 * 1.04];
        assert!(speck <= before, "{keep_thin}: {speck} mm^3 of {before}");
    }
}

#[test]
fn films_between_materials_vanish_at_a_scale() {
    // a film of label 3 between labels 1 and 2, at a scale of five voxels
    let film = |thickness: usize| {
        let layered = volume([30, 30, 30], |[i, j, k]| {
            let is_in = [i, j, k].iter().all(|n| (4..26).contains(n));
            let label = if i < 15 {
                1
            } else if i < 15 + thickness {
                3
            } else {
                2
            };
            if is_in { label } else { 0 }
        });
        let made = scaled(layered, 5.0);
        let change = |id: usize| made.survey.volumes[id] / (made.extracted.tallies[id].voxels as f64 * 1.04) - 1.0;
        [change(3), change(1)]
    };
    // a film of one voxel vanishes, and its neighbours take half of it each
    let [film_of_one, neighbour] = film(1);
    assert_eq!(film_of_one, -1.0);
    assert!((0.02..0.08).contains(&neighbour), "{neighbour}");
    let [film_of_three, neighbour] = film(3);
    assert!(film_of_three.abs() < 0.1 && neighbour.abs() < 0.05, "{film_of_three} {neighbour}");
}

#[test]
fn sizes_of_materials_set_the_scales_of_their_interfaces() {
    let names = ["outside", "1", "2", "3", "4"].map(str::to_owned);
    let scales = |size: &str| {
        let given = Given::new(&[size.parse().expect("a size")], &names).expect("a material");
        Scales::new(Scale { length: 0.0, keep_thin: false }, given, 1.01)
    };
    assert!(scales("1=0.75").is_none(), "edges of 0.75 voxel need no scale");
    let own = scales("1=3.125").expect("a scale");
    assert_eq!(own.lengths(5), [2.7 * 1.01, 5.0]);
    let made = make_with(sectors(40, 10.5), Border::Cap, MaterialOptions { scales: Some(own), ..OPTIONS });
    for id in 0..4 {
        let change = made.survey.volumes[id] / (made.extracted.tallies[id].voxels as f64 * 1.04) - 1.0;
        assert!(change.abs() < 0.025, "{id}: {change}");
    }
    let all = scaled(sectors(40, 10.5), 5.0);
    let [first, others] = [roughness(&made, |id| id == 1), roughness(&made, |id| id > 1)];
    let [expected, stepped] = [&all, &make(sectors(40, 10.5), Border::Cap)].map(|made| roughness(made, |id| id == 1));
    // the measured angle is 1.2 degrees for sector 1 and 4.2 degrees for the others; for sector 1,
    // it is 0.9 degree if all materials have a scale of 5 mm, and 3.3 degrees without a scale
    let found = [first, others, expected, stepped];
    assert!(first < 1.5 * expected && others < 1.5 * stepped, "{found:?}");
    // the three sectors and the outside around them each remain a single part
    let components = made.extracted.tallies.iter().map(|tally| tally.parts[1].components);
    assert_eq!(components.take(4).collect::<Vec<_>>(), [1; 4]);
}

#[test]
fn a_scale_preserves_volumes_of_materials_far_from_outside() {
    // the outside fills one corner, and three slabs fill the rest of the volume; two of the slabs
    // are far from the outside and touch the border of the volume
    let slabs = volume([48, 16, 16], |[i, j, k]| if i < 8 && j < 8 && k < 8 { 0 } else { 1 + (i / 16) as u8 });
    let made = scaled(slabs, 3.0);
    for id in 0..4 {
        let change = made.survey.volumes[id] / (made.extracted.tallies[id].voxels as f64 * 1.04) - 1.0;
        assert!(change.abs() < 0.05, "{id}: {change}");
    }
}

#[test]
fn lost_parts_of_each_material_are_reported_with_their_volume() {
    let folder = tempfile::tempdir().expect("folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("text").to_owned();
    let (input, output, report) = (at("in.nrrd"), at("out.vti"), at("report.json"));
    // two blocks, and separate voxels with the labels of the blocks: 4 with label 1 and 24 with
    // label 2
    let size = [60, 30, 30];
    let is_in = |at: usize, low: usize, high: usize| (low..high).contains(&at);
    let labels = (0..60 * 30 * 30).map(|n: usize| {
        let (i, j, k) = (n % 60, n / 60 % 30, n / 1800);
        match i {
            3..23 if is_in(j, 3, 23) && is_in(k, 3, 23) => 1,
            33..49 if is_in(j, 3, 19) && is_in(k, 3, 19) => 2,
            5 | 9 if k == 27 && (j == 5 || j == 9) => 1,
            33..57 if i % 2 == 1 && k == 26 && (j == 24 || j == 28) => 2,
            _ => 0,
        }
    });
    let (geometry, labels) = (Geometry::axis_aligned(size, DVec3::ONE), nrrd::Voxels::U8(labels.collect()));
    nrrd::write(Path::new(&input), &geometry, nrrd::FileSpace::Lps, &labels, true).expect("written");
    let run = distfield(&[
        &input,
        "-o",
        &output,
        "--material",
        "big=1",
        "--material",
        "small=2",
        "--scale",
        "4",
        "--report",
        &report,
    ]);
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(&report).expect("a report")).expect("JSON");
    let warnings: Vec<&str> =
        report["warnings"].as_array().expect("warnings").iter().filter_map(|w| w.as_str()).collect();
    let told = |words: &str| assert!(warnings.iter().any(|warning| warning.contains(words)), "{words}: {warnings:?}");
    told("'small' loses 24 parts, 24 mm^3 (0.58 % of its volume)");
    told("less than 0.1 % of each material): 'big' 4 parts, 4 mm^3");
}

#[test]
fn scale_for_vertices_uses_the_area_of_all_interfaces() {
    let folder = tempfile::tempdir().expect("folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("text").to_owned();
    let (input, output) = (at("in.nrrd"), at("out.vti"));
    write_halves(Path::new(&input));
    let vertices = 500.0;
    let run = distfield(&[&input, "-o", &output, "--material", "all", "--scale-for-vertices", "500"]);
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    let made = read_materials(Path::new(&output)).expect("read");
    let interfaces = made.meta["interfaces"].as_array().expect("interfaces");
    assert_eq!(interfaces.len(), 4);
    let area: f64 = interfaces.iter().filter_map(|pair| pair["area"].as_f64()).sum();
    let length = (2.0 * area / (3f64.sqrt() * vertices)).sqrt();
    let scale = made.meta["scale"].as_f64().expect("a scale");
    assert!((scale / (1.6 * length) - 1.0).abs() < 0.1, "{scale} mm for edges of {length} mm");
}

#[test]
fn one_material_at_a_scale_equals_one_object() {
    let folder = tempfile::tempdir().expect("folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("text").to_owned();
    let input = at("in.nrrd");
    write_halves(Path::new(&input));
    let run = |choice: [&str; 2], output: &str| {
        let run = distfield(&[&input, "-o", output, choice[0], choice[1], "--scale-for-size", "2"]);
        assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    };
    let (many, one) = (at("many.vti"), at("one.vti"));
    run(["--material", "ball=1+2"], &many);
    run(["--labels", "1,2"], &one);
    let (many, one) = (
        read_materials(Path::new(&many)).expect("read"),
        CubicSpline::new(&read_field(Path::new(&one), FieldKind::Distance).expect("read").image),
    );
    assert!(many.meta["scale"].as_f64().is_some_and(|scale| (scale - 3.2).abs() < 1e-9), "{}", many.meta);
    let centre = one.geometry().index_to_grid(DVec3::splat(7.6 + MARGIN as f64));
    let mut worst = 0.0f64;
    for n in 0..300 {
        let way = DVec3::new(uniform(3, 0, n), uniform(3, 1, n), uniform(3, 2, n)) - 0.5;
        let p = one.project(centre + way.normalize() * 5.0, 2.0, 1e-7).expect("near the surface");
        worst = worst.max(many.materials.difference_gradient(MaterialId(1), MaterialId(0), p).0.abs());
    }
    assert!(worst < 0.01, "{worst}");
}

#[test]
fn pieces_of_real_volumes_keep_every_voxel() {
    // pieces of real volumes where many labels meet, because the whole volumes would take minutes
    let mut decided_by_little = 0;
    for (name, first, least) in
        [("thorax_labels.nrrd", [110, 90, 80], 3), ("brain_parcellation.nrrd", [70, 110, 110], 12)]
    {
        let Some(path) = real_volume(name) else { continue };
        let whole = read_volume(&path).expect("read");
        let (labels, grid) = (whole.voxels.to_f32(), whole.geometry);
        let piece = volume([36; 3], |[i, j, k]| labels[grid.linear(first[0] + i, first[1] + j, first[2] + k)] as u8);
        let made = make(piece, Border::Cap);
        made.keeps_every_voxel(name);
        let [edges, near_a_third, open, narrow] = made.keeps_contacts(name);
        assert!(narrow <= open / 20, "{name}: {narrow} of {open}");
        let ContactReport { crossed, undecided, raised, .. } = made.extracted.contacts;
        println!("{name}: undecided {undecided}");
        decided_by_little += undecided;
        assert!(edges > near_a_third && near_a_third > 1000 && crossed > 50 && raised > crossed, "{name}");
        assert!(made.survey.volumes.len() >= least, "{name}: {} materials", made.survey.volumes.len());
        assert!(made.survey.junctions.edges_of_three > 100, "{name}: {:?}", made.survey.junctions);
    }
    assert!(decided_by_little > 0);
}

fn distfield(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_distfield")).args(arguments).output().expect("the program runs")
}

/// Writes a ball in a block of label 3. The halves of the ball have the labels 1 and 2.
fn write_halves(path: &Path) {
    let size = 16;
    let at = |n: usize| [n % size, n / size % size, n / (size * size)];
    let label = |[i, j, k]: [usize; 3]| {
        let is_ball = [i, j, k].map(|n| (n as f64 - 7.6).powi(2)).iter().sum::<f64>() < 25.0;
        if is_ball { 1 + u8::from(i > 7) } else { 3 * u8::from([i, j, k].iter().all(|n| (1..15).contains(n))) }
    };
    let mut bytes =
        format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: {size} {size} {size}\nspacings: 1 1 1\nencoding: raw\n\n")
            .into_bytes();
    bytes.extend((0..size * size * size).map(|n| label(at(n))));
    std::fs::write(path, bytes).expect("written");
}

#[test]
fn materials_file_reads_back_for_any_number_of_threads() {
    let folder = tempfile::tempdir().expect("folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("text").to_owned();
    let (input, output, report) = (at("in.nrrd"), at("case.materials.vti"), at("report.json"));
    write_halves(Path::new(&input));
    let materials = ["--material", "left=1", "--material", "right=2", "--material", "rest=3", "--report", &report];
    let run = |output: &str, threads: &str| {
        let fixed = [&input, "-o", output, "--threads", threads, "--force"];
        let run = distfield(&[&fixed[..], &materials[..]].concat());
        assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
        std::fs::read(output).expect("bytes")
    };
    let first = run(&output, "1");
    assert!(first == run(&output, "2"), "the bytes depend on the number of threads");
    let told: serde_json::Value = serde_json::from_slice(&std::fs::read(&report).expect("report")).expect("JSON");
    let told = &told["results"];
    let row = &told["materials"][2];
    assert_eq!((&row["name"], &row["components"], &row["voxels_changed"]), (&json!("right"), &json!(1), &json!(0)));
    assert!(row["voxels"].as_u64().is_some_and(|count| count > 200), "{row}");
    assert_eq!(told["interfaces"].as_array().map(Vec::len), Some(4), "{told}");
    assert!(told["junctions"]["edges_of_three"].as_u64().is_some_and(|count| count > 10), "{told}");
    assert_eq!(told["voxels_changed"], 0);
    assert!(
        told["contacts"]["raised"].as_u64().is_some_and(|count| count > 0) && told["contacts"]["left"] == 0,
        "{told}"
    );
    assert!(told["state_bytes"].as_u64().is_some_and(|bytes| bytes > 1000), "{told}");

    let file = read_materials(Path::new(&output)).expect("materials");
    let names: Vec<&str> = file.materials.table().iter().map(|material| material.name.as_str()).collect();
    assert_eq!(names, ["outside", "left", "right", "rest"]);
    assert_eq!((&file.meta["version"], &file.meta["border"]), (&json!(1), &json!("cap")));
    assert_eq!(file.history.expect("history").inputs.len(), 1);
    // the active scalars of the file are the numbers of the materials with the smallest indicators
    let shown = read_volume(Path::new(&output)).expect("the active scalars");
    let numbers = shown.voxels.to_f32();
    let [nx, ny, _] = shown.geometry.size;
    for (n, number) in numbers.iter().enumerate() {
        let node = DVec3::new((n % nx) as f64, (n / nx % ny) as f64, (n / (nx * ny)) as f64);
        assert_eq!(f32::from(file.materials.material_at(node).0), *number);
    }
    // the halves and the block meet on a circle
    let own = [1, 2, 3].map(MaterialId);
    let start = DVec3::new(12.5, 12.6, 17.3);
    let p = file.materials.project_onto_curve(own, start, 2.0, 1e-6).expect("a point of the curve");
    assert!(file.materials.clearance(p, &own) > 0.0);
    assert!((p.x - 12.5).abs() < 0.3 && (p.distance(DVec3::splat(12.6)) - 5.0).abs() < 0.5, "{p}");

    // a reader for one object rejects the file
    let error = read_field(Path::new(&output), FieldKind::Distance).expect_err("many materials");
    assert!(error.what.contains("many materials") && error.next.contains("--labels"), "{error}");

    // a damaged file is rejected or read, without a panic
    let whole = std::fs::read(&output).expect("bytes");
    let damaged = PathBuf::from(at("damaged.vti"));
    for n in 0..120u64 {
        let mut bytes = whole.clone();
        if n % 3 == 0 {
            bytes.truncate((uniform(7, 0, n) * whole.len() as f64) as usize);
        } else {
            // most fields are in the header
            let reach = if n % 3 == 1 { whole.len().min(12_000) } else { whole.len() };
            let at = (uniform(7, 1, n) * reach as f64) as usize;
            bytes[at] = (uniform(7, 2, n) * 256.0) as u8;
        }
        std::fs::write(&damaged, bytes).expect("written");
        let _ = read_materials(&damaged);
    }
}

#[test]
fn invalid_material_choices_are_rejected() {
    let folder = tempfile::tempdir().expect("folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("text").to_owned();
    let (input, output) = (at("in.nrrd"), at("out.vti"));
    write_halves(Path::new(&input));
    for (options, said) in [
        (&["--material", "a=9"][..], "no voxel has the label 9"),
        (&["--material", "a=1", "--material", "b=1"], "already belongs to the material 'a'"),
        (&["--material", "a=1", "--material", "a=2"], "the name 'a' is already used"),
        (&["--material", "heart"], "no label in the file has this name"),
        (&["--material", "outside=1"], "is reserved for voxels without a material"),
        (&["--material", "all", "--labels", "1"], "cannot be used with"),
        (&["--material", "all", "--iso", "1"], "cannot be used with"),
        (&["--material", "all", "--scale-for-vertices", "3"], "3 is not in"),
        (&["--material", "all", "--keep", "largest"], "--keep cannot be combined with MATERIALS (--material)"),
    ] {
        let run = distfield(&[&[&input, "-o", &output][..], options].concat());
        let error = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(2), "{options:?}: {error}");
        assert!(error.contains(said), "{options:?}: {error}");
        assert!(!Path::new(&output).exists());
    }
}

#[test]
fn mickey() {
    let Some(path) = real_volume("mickey_labels.nrrd") else { return };
    let made = make(read_volume(&path).expect("read"), Border::Cap);
    made.keeps_every_voxel("mickey");
    made.keeps_contacts("mickey");
    let pairs: Vec<_> = made.survey.interfaces.iter().map(|pair| pair.materials.map(|id| id.0)).collect();
    assert_eq!(pairs, [[0, 1], [1, 2], [1, 3], [1, 4], [2, 3], [2, 4], [2, 5]]);
    // two balls of radius 5.8 rest on a hollow ball
    let area = |pair: usize| made.survey.interfaces[pair].area;
    assert!((area(2) / area(3) - 1.0).abs() < 0.01 && (area(4) / area(5) - 1.0).abs() < 0.01);
    assert_eq!((made.survey.junctions.edges_of_four, made.survey.junctions.corners), (0, 0));
    assert!(made.survey.junctions.edges_of_three > 50);
}
