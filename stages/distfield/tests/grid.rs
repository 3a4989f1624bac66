//! Compares `--grid object` with `--grid volume`: near the surface, the field is the same at the
//! same world position, and only borders of the volume are treated as borders.

use glam::{DMat3, DVec3};
use isoparticles_field::materials::Indicators;
use isoparticles_stage::field_file::{Field, FieldKind, read_field};
use isoparticles_stage::materials_file::read_materials;
use isoparticles_volume::nrrd::{Encoding, write_nrrd};
use isoparticles_volume::{Geometry, Image, Space, Voxels};
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// Limits of the difference in F, in units of the mean voxel spacing: 99th percentile within three
/// voxels of the surface, and maximum within one voxel. Nodes in the groove between the two balls
/// are equally far from both balls; at one of these nodes, the values of F differ by 0.022 voxel.
const SAME: (f64, f64) = (0.006, 0.03);

fn distfield(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_distfield")).args(arguments).output().expect("the program runs")
}

/// Returns a grid with rotated axes and negative coordinates at its first voxel.
fn oblique(size: [usize; 3], spacing: DVec3) -> Geometry {
    let directions = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.6);
    Geometry {
        directions,
        origin: DVec3::new(-120.5, 33.25, -310.0),
        space: Space::Lps,
        ..Geometry::axis_aligned(size, spacing)
    }
}

/// Creates a folder with a volume whose voxel values are a function of the position in the grid
/// frame, mm.
fn folder(geometry: &Geometry, value: impl Fn(DVec3) -> f32) -> TempDir {
    let folder = tempfile::tempdir().expect("folder");
    let image = Image::sampled(geometry.clone(), value);
    write_nrrd(&folder.path().join("in.nrrd"), geometry, &Voxels::F32(image.data), Encoding::Raw).expect("written");
    folder
}

fn run(folder: &Path, output: &str, options: &[&str]) -> String {
    let (input, output) = (folder.join("in.nrrd"), folder.join(output));
    let files = [input.to_str().expect("text"), "-o", output.to_str().expect("text"), "--force"];
    let run = distfield(&[&files[..], options].concat());
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert_eq!(run.status.code(), Some(0), "{options:?}: {said}");
    said
}

/// Computes the fields of the whole volume and of the object's box.
fn both(folder: &Path, options: &[&str]) -> [Field; 2] {
    ["volume", "object"].map(|grid| {
        run(folder, "f.vti", &[options, &["--grid", grid]].concat());
        read_field(&folder.join("f.vti"), FieldKind::Distance).expect("a field")
    })
}

/// Returns the node of the larger grid that has the world coordinates of the first node of the
/// smaller grid.
fn place_of(small: &Geometry, large: &Geometry) -> [usize; 3] {
    assert_eq!((small.spacing, small.directions, small.space), (large.spacing, large.directions, large.space));
    let at = large.grid_to_index(large.world_to_grid(small.origin));
    assert!((at - at.round()).abs().max_element() < 1e-9, "between nodes: {at}");
    at.round().to_array().map(|n| n as usize)
}

/// Fails if the fields differ near the surface, or if the smaller grid misses an inside node.
fn assert_same([whole, part]: &[Field; 2], what: &str) {
    let (large, small) = (&whole.image.geometry, &part.image.geometry);
    let first = place_of(small, large);
    let voxel = large.mean_spacing();
    let (mut inside, mut worst, mut differences) = (0, 0.0f64, Vec::new());
    for (n, &f) in part.image.data.iter().enumerate() {
        let [nx, ny, _] = small.size;
        let [i, j, k] = [n % nx, n / nx % ny, n / (nx * ny)];
        let expected = whole.image.at(first[0] + i, first[1] + j, first[2] + k);
        inside += usize::from(expected < 0.0);
        let (distance, difference) = [expected, f - expected].map(|f| f64::from(f.abs()) / voxel).into();
        if distance < 1.0 {
            worst = worst.max(difference);
        } else {
            assert_eq!(f < 0.0, expected < 0.0, "{what}: node {i} {j} {k}, {f} and {expected}");
        }
        if distance < 3.0 {
            differences.push(difference);
        }
    }
    assert_eq!(inside, whole.image.data.iter().filter(|&&f| f < 0.0).count(), "{what}: something was cut off");
    differences.sort_by(f64::total_cmp);
    let p99 = differences[differences.len() * 99 / 100];
    assert!(
        p99 < SAME.0 && worst < SAME.1,
        "{what}: F differs by {p99} voxels (99th percentile), {worst} at most near the surface"
    );
}

/// Fails if components, cavities or the volume of the voxels differ between the fields.
fn assert_same_notes([whole, part]: &[Field; 2], what: &str) {
    for key in ["components", "cavities", "volume_before"] {
        assert_eq!(whole.meta[key], part.meta[key], "{what}: {key}");
    }
}

/// Returns the value of the implicit function of two intersecting balls with radii of 9 and 6 mm in
/// a corner of a volume, negative inside.
fn two_balls(p: DVec3) -> f64 {
    let (a, b) = (DVec3::new(30.0, 31.0, 29.0), DVec3::new(39.0, 36.0, 33.0));
    (p.distance(a) - 9.0).min(p.distance(b) - 6.0)
}

#[test]
fn field_of_the_object_box_equals_field_of_the_whole_volume() {
    for (size, spacing) in [([90, 84, 76], DVec3::ONE), ([100, 84, 40], DVec3::new(0.9, 1.1, 2.5))] {
        let labels = folder(&oblique(size, spacing), |p| if two_balls(p) < 0.0 { 2.0 } else { 0.0 });
        let scan = folder(&oblique(size, spacing), |p| (100.0 - 30.0 * two_balls(p)).clamp(-300.0, 280.0) as f32);
        for (folder, options) in [
            (&labels, &["--labels", "2"][..]),
            (&labels, &["--labels", "2", "--border", "open"]),
            (&labels, &["--labels", "2", "--scale", "4"]),
            (&labels, &["--labels", "2", "--scale-for-vertices", "300"]),
            (&labels, &["--labels", "2", "--scale", "4", "--keep-thin"]),
            (&scan, &["--iso", "100.5"]),
            (&scan, &["--iso", "100.5", "--border", "open"]),
            (&scan, &["--iso", "100.5", "--scale", "4"]),
        ] {
            let fields = both(folder.path(), options);
            let what = format!("{options:?}, voxels of {spacing}");
            assert_same(&fields, &what);
            assert_same_notes(&fields, &what);
            let [whole, part] = fields.map(|field| field.image.geometry.voxel_count());
            assert!(3 * part < whole, "{options:?}: {part} of {whole} nodes");
        }
    }
}

#[test]
fn only_true_borders_of_the_volume_are_capped_or_open() {
    let geometry = oblique([60, 70, 66], DVec3::ONE);
    // the borders at low x and high z cut this ball
    let centre = DVec3::new(0.0, 30.0, 60.0);
    let labels = folder(&geometry, |p| if p.distance(centre) < 12.3 { 1.0 } else { 0.0 });
    for border in ["cap", "open"] {
        let fields = both(labels.path(), &["--labels", "1", "--border", border]);
        assert_same(&fields, border);
        // the cap planes have the same positions in the world
        let planes = fields.each_ref().map(|field| {
            let planes = field.meta["cap_planes"].as_array().expect("a list").clone();
            let place = |plane: &serde_json::Value| {
                let axis = plane["axis"].as_u64().expect("an axis") as usize;
                let grid = DVec3::AXES[axis] * plane["position"].as_f64().expect("a place");
                let world = field.image.geometry.grid_to_world(grid);
                (axis, plane["side"].to_string(), (field.image.geometry.directions.col(axis).dot(world) * 1e6).round())
            };
            planes.iter().map(place).collect::<Vec<_>>()
        });
        assert_eq!(planes[0], planes[1], "{border}");
        assert_eq!(planes[0].len(), if border == "cap" { 2 } else { 0 }, "{border}");
    }
    // the complement of a ball touches all borders
    let [whole, part] = both(
        folder(&geometry, |p| p.distance(DVec3::splat(30.0)) as f32).path(),
        &["--iso", "12.3", "--inside", "above"],
    );
    assert_eq!(whole.image, part.image);
}

#[test]
fn noise_beyond_the_box_adds_no_object_at_an_open_border() {
    // outside the balls, values alternate between -400 and just below the iso value, so that the
    // spline can exceed the iso value where there is no object
    let noisy = |p: DVec3| {
        let alternates = if (p.x + p.y + p.z) as i64 % 2 == 0 { 99.9 } else { -400.0 };
        if two_balls(p) < 0.0 { 300.0 } else { alternates }
    };
    let folder = folder(&oblique([90, 84, 76], DVec3::ONE), |p| noisy(p) as f32);
    let options = ["--iso", "100", "--kind", "scan", "--border", "open", "--grid", "object"];
    run(folder.path(), "f.vti", &options);
    let field = read_field(&folder.path().join("f.vti"), FieldKind::Distance).expect("a field").image;
    let Geometry { size: [nx, ny, nz], .. } = field.geometry;
    let on_rim = |n: usize| {
        let at = [n % nx, n / nx % ny, n / (nx * ny)];
        at.contains(&0) || at[0] + 1 == nx || at[1] + 1 == ny || at[2] + 1 == nz
    };
    assert!((0..field.data.len()).filter(|&n| on_rim(n)).all(|n| field.data[n] > 0.0), "an object at the rim");
}

#[test]
fn many_materials_have_the_box_of_all_but_the_outside() {
    let material = |p: DVec3| match two_balls(p) {
        f if f >= 0.0 => 0.0,
        _ if p.x < 34.0 => 1.0,
        _ => 2.0,
    };
    let folder = folder(&oblique([90, 84, 76], DVec3::ONE), material);
    for options in [&["--material", "all"][..], &["--material", "all", "--scale", "4"]] {
        let [whole, part] = ["volume", "object"].map(|grid| {
            run(folder.path(), "m.vti", &[options, &["--grid", grid]].concat());
            read_materials(&folder.path().join("m.vti")).expect("materials").materials
        });
        let (large, small) = (whole.geometry(), part.geometry());
        assert!(5 * small.voxel_count() < large.voxel_count(), "{options:?}");
        let shift = large.index_to_grid(DVec3::from_array(place_of(small, large).map(|n| n as f64)));
        let mut compared = 0;
        for n in 0..small.voxel_count() {
            let [nx, ny, _] = small.size;
            let at = DVec3::from_array([n % nx, n / nx % ny, n / (nx * ny)].map(|n| n as f64));
            let grid = small.index_to_grid(at + 0.3);
            let (a, b) = (whole.near(grid + shift), part.near(grid));
            assert_eq!(a.first(), b.first(), "{options:?}: {grid}");
            let (a, b) = (a.interface_distance(), b.interface_distance());
            if a < 2.0 {
                compared += 1;
                assert!((a - b).abs() < SAME.0, "{options:?}: {a} and {b} at {grid}");
            }
        }
        assert!(compared > 1000, "{options:?}: {compared}");
    }
}

#[test]
fn report_has_the_grid_and_errors_do_not_depend_on_it() {
    let folder =
        folder(&oblique([60, 58, 57], DVec3::ONE), |p| if p.distance(DVec3::splat(20.0)) < 5.0 { 1.0 } else { 0.0 });
    let report = folder.path().join("report.json");
    let said = run(folder.path(), "f.vti", &["--labels", "1", "--report", report.to_str().expect("text")]);
    assert!(said.contains("grid, nodes") && said.contains(" of 70 x 68 x 67 ("), "{said}");
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(report).expect("a report")).expect("JSON");
    assert_eq!(report["results"]["grid"]["nodes_of_volume"], serde_json::json!([70, 68, 67]));
    assert_eq!(report["parameters"]["grid"], "object");
    let field = read_field(&folder.path().join("f.vti"), FieldKind::Distance).expect("a field");
    assert_eq!(report["results"]["grid"]["nodes"], serde_json::json!(field.image.geometry.size));
    assert_eq!(field.history.expect("history").parameters["grid"], "object");

    let input = folder.path().join("in.nrrd");
    for (options, what) in [
        (["--labels", "7"], "no voxel has the label 7"),
        (["--iso", "2"], "no voxel crosses iso value 2"),
        (["--material", "a=7"], "no voxel has the label 7"),
    ] {
        let told = ["object", "volume"].map(|grid| {
            let output = folder.path().join("none.vti");
            let files = [input.to_str().expect("text"), "-o", output.to_str().expect("text"), "--grid", grid];
            let run = distfield(&[&files[..], &options].concat());
            assert_eq!(run.status.code(), Some(2), "{options:?}");
            assert!(!output.exists(), "{options:?}");
            String::from_utf8_lossy(&run.stderr).into_owned()
        });
        assert!(told[0].contains(what), "{options:?}: {}", told[0]);
        assert_eq!(told[0], told[1]);
    }
}
