//! Tests the program: input and output files, exit codes, invalid input, and real volumes if they
//! are available.

use isoparticles_stage::field_file::{FieldKind, read_field};
use isoparticles_tests::skip::real_volume;
use std::path::Path;
use std::process::{Command, Output};

fn distfield(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_distfield")).args(arguments).output().expect("the program runs")
}

/// Writes a raw NRRD file of 32-bit numbers.
fn write_nrrd(path: &Path, size: [usize; 3], value: impl Fn(usize, usize, usize) -> f32) {
    let [nx, ny, nz] = size;
    let header = format!(
        "NRRD0004\ntype: float\ndimension: 3\nsizes: {nx} {ny} {nz}\nspacings: 1 1 1\nendian: little\nencoding: raw\n\n"
    );
    let mut bytes = header.into_bytes();
    for k in 0..nz {
        for j in 0..ny {
            for i in 0..nx {
                bytes.extend(value(i, j, k).to_le_bytes());
            }
        }
    }
    std::fs::write(path, bytes).expect("written");
}

fn radius(i: usize, j: usize, k: usize) -> f32 {
    [i, j, k].map(|n| (n as f32 - 6.2).powi(2)).iter().sum::<f32>().sqrt()
}

#[test]
fn a_volume_gives_a_field_with_history() {
    let folder = tempfile::tempdir().expect("folder");
    let (input, output) = (folder.path().join("in.nrrd"), folder.path().join("f.vti"));
    write_nrrd(&input, [13, 13, 13], |i, j, k| 10.0 - radius(i, j, k));
    let (input, output) = (input.to_str().expect("text"), output.to_str().expect("text"));
    let run = distfield(&[input, "-o", output, "--iso", "6", "--threads", "1"]);
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    assert!(run.stdout.is_empty());
    let field = read_field(Path::new(output), FieldKind::Distance).expect("a field");
    assert_eq!(field.image.geometry.size, [23, 23, 23]);
    assert_eq!(field.meta["source"], "scalar");
    assert_eq!(field.meta["iso"], 6.0);
    assert_eq!(field.meta["border"], "cap");
    assert_eq!(field.meta["components"], 1);
    assert!(field.meta["cap_planes"].as_array().is_some_and(Vec::is_empty), "the ball meets no face");
    assert_eq!(field.history.expect("history").inputs.len(), 1);

    // The output has the same bytes for another number of threads. Without --force, an existing
    // output is kept.
    let first = std::fs::read(output).expect("bytes");
    assert_eq!(distfield(&[input, "-o", output, "--iso", "6"]).status.code(), Some(2));
    assert_eq!(distfield(&[input, "-o", output, "--iso", "6", "--threads", "2", "--force"]).status.code(), Some(0));
    assert!(first == std::fs::read(output).expect("bytes"), "the bytes depend on the number of threads");
}

#[test]
fn labels_give_the_same_bytes_on_any_number_of_threads() {
    let folder = tempfile::tempdir().expect("folder");
    let input = folder.path().join("in.nrrd");
    // a ball and a separate voxel, on a grid with more nodes than one task processes
    let ball = |n: [usize; 3]| n.map(|n| (n as f32 - 19.3).powi(2)).iter().sum::<f32>() < 196.0;
    write_nrrd(&input, [40, 40, 40], |i, j, k| f32::from(u8::from(ball([i, j, k]) || [i, j, k] == [36, 36, 36])));
    let fields = ["1", "2", "3"].map(|threads| {
        let output = folder.path().join(format!("f{threads}.vti"));
        let (input, path) = (input.to_str().expect("text"), output.to_str().expect("text"));
        let options = ["--labels", "1", "--keep", "largest", "--threads", threads];
        let run = distfield(&[&[input, "-o", path][..], &options[..]].concat());
        assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
        read_field(&output, FieldKind::Distance).expect("a field").image
    });
    assert!(fields[0] == fields[1] && fields[0] == fields[2], "F depends on the number of threads");
}

#[test]
fn scale_zero_changes_nothing_and_a_chosen_scale_has_a_reason() {
    let folder = tempfile::tempdir().expect("folder");
    let input = folder.path().join("in.nrrd");
    write_nrrd(&input, [40, 40, 40], |i, j, k| if [i, j, k].iter().all(|n| (9..30).contains(n)) { 1.0 } else { 0.0 });
    let run = |options: &[&str]| {
        let output = folder.path().join("f.vti");
        let (input, path) = (input.to_str().expect("text"), output.to_str().expect("text"));
        let run = distfield(&[&[input, "-o", path, "--force", "--labels", "1"][..], options].concat());
        assert_eq!(run.status.code(), Some(0), "{options:?}: {}", String::from_utf8_lossy(&run.stderr));
        (read_field(&output, FieldKind::Distance).expect("a field"), String::from_utf8_lossy(&run.stderr).into_owned())
    };
    let (plain, _) = run(&[]);
    for zero in [&["--scale", "0"][..], &["--scale-for-size", "0.7"], &["--quality", "medium"]] {
        let (field, _) = run(zero);
        assert!(field.image.data == plain.image.data, "{zero:?} changed F");
        assert_eq!(field.meta, plain.meta, "{zero:?}");
    }
    for (options, low, high) in [
        (&["--scale", "5"][..], 5.0, 5.0),
        (&["--scale-for-size", "4"], 6.4, 6.4),
        // scales of 1.6 and 2.4 would show voxel steps
        (&["--scale-for-size", "1"], 2.7, 2.7),
        (&["--quality", "coarse"], 2.7, 2.7),
        // six faces of 21 x 21 mm, with rounded edges
        (&["--scale-for-vertices", "200"], 5.5, 6.3),
    ] {
        let (field, said) = run(options);
        let scale = field.meta["scale"].as_f64().expect("a number");
        assert!((low - 1e-9..high + 1e-9).contains(&scale), "{options:?}: {scale}");
        assert!(said.contains("scale, mm") && field.meta["scale_reason"].is_string(), "{said}");
        let changes = &field.meta["scale_changes"];
        assert_eq!(changes["components"], serde_json::json!([1, 1]));
        assert!(changes["voxels_changed"].as_u64().is_some_and(|n| n > 0), "the corners are rounded");
        let kept = field.meta["volume"].as_f64().expect("a number") / 21f64.powi(3);
        assert!((kept - 1.0).abs() < 0.02, "{options:?}: {kept} of the volume");
    }
    for wrong in [&["--scale", "-1"][..], &["--scale", "2", "--scale-for-size", "2"], &["--scale-for-vertices", "2"]] {
        let arguments = [&["in.nrrd", "-o", "x.vti", "--labels", "1"][..], wrong].concat();
        assert_eq!(distfield(&arguments).status.code(), Some(2), "{wrong:?}");
    }
    let output = folder.path().join("gone.vti");
    let arguments =
        [input.to_str().expect("text"), "-o", output.to_str().expect("text"), "--labels", "1", "--scale", "90"];
    let gone = distfield(&arguments);
    let said = String::from_utf8_lossy(&gone.stderr);
    assert_eq!(gone.status.code(), Some(2), "{said}");
    assert!(said.contains("why it matters:") && said.contains("what to do:") && !output.exists(), "{said}");
}

#[test]
fn a_cut_object_names_its_cap_planes() {
    let folder = tempfile::tempdir().expect("folder");
    let (input, output) = (folder.path().join("in.nrrd"), folder.path().join("f.vti"));
    write_nrrd(
        &input,
        [10, 12, 12],
        |i, j, k| if i < 4 && (3..9).contains(&j) && (3..9).contains(&k) { 2.0 } else { 0.0 },
    );
    let run = distfield(&[
        input.to_str().expect("text"),
        "-o",
        output.to_str().expect("text"),
        "--labels",
        "2",
        "--margin",
        "4",
    ]);
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    let field = read_field(&output, FieldKind::Distance).expect("a field");
    assert_eq!(field.meta["cap_planes"], serde_json::json!([{ "axis": 0, "side": "low", "position": 3.5 }]));
    assert_eq!(field.meta["voxels_changed"], 0);
    assert_eq!(field.meta["volume_before"], 144.0);
}

#[test]
fn bad_input_gives_exit_code_2_a_message_and_no_output() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name);
    write_nrrd(&path("good.nrrd"), [8, 8, 8], |i, j, k| radius(i, j, k).floor());
    write_nrrd(&path("nan.nrrd"), [8, 8, 8], |i, j, k| if (i, j, k) == (3, 2, 1) { f32::NAN } else { i as f32 });
    write_nrrd(&path("flat.nrrd"), [8, 8, 8], |_, _, _| 7.0);
    write_nrrd(&path("half.nrrd"), [8, 8, 8], |i, _, _| i as f32 + 0.5);
    let cases: [(&str, &[&str], &str); 7] = [
        ("nan.nrrd", &["--iso", "2"], "1 voxels are NaN or infinite, the first at index (3, 2, 1)"),
        ("flat.nrrd", &["--iso", "7"], "every voxel has the value 7"),
        ("good.nrrd", &["--iso", "100"], "ranges from 0 to 10"),
        ("good.nrrd", &["--iso=-3"], "ranges from 0 to 10"),
        ("good.nrrd", &["--labels", "3,77"], "labels present: 1, 2"),
        ("half.nrrd", &["--labels", "1"], "not whole numbers"),
        ("absent.nrrd", &["--iso", "1"], "absent.nrrd"),
    ];
    for (input, options, says) in cases {
        let output = path("out.vti");
        let input = path(input);
        let mut arguments = vec![input.to_str().expect("text"), "-o", output.to_str().expect("text")];
        arguments.extend(options);
        let run = distfield(&arguments);
        let message = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(says), "{arguments:?} should say '{says}': {message}");
        assert!(message.contains("why it matters:") && message.contains("what to do:"), "{message}");
        assert!(!output.exists(), "{arguments:?} left an output behind");
    }
    let both = distfield(&["in.nrrd", "-o", "x.vti", "--iso", "1", "--labels", "1"]);
    assert_eq!(both.status.code(), Some(2));
    assert_eq!(distfield(&["in.nrrd", "-o", "x.vti"]).status.code(), Some(2));
}

#[test]
fn real_volumes_keep_their_zero_set_and_parts() {
    // the last entry is false for a noisy volume, whose parts can be connected by necks thinner
    // than a voxel
    for (name, option, value, is_plain) in [
        ("tooth_ct.nrrd", "--iso", "600", true),
        ("tooth_ct.nrrd", "--iso", "1000", true),
        ("mickey_labels.nrrd", "--labels", "2,3,4,5", true),
        ("heart_ct.nrrd", "--iso", "250", false),
    ] {
        let Some(input) = real_volume(name) else { continue };
        let folder = tempfile::tempdir().expect("folder");
        let output = folder.path().join("f.vti");
        let run = distfield(&[input.to_str().expect("text"), "-o", output.to_str().expect("text"), option, value]);
        assert_eq!(run.status.code(), Some(0), "{name}: {}", String::from_utf8_lossy(&run.stderr));
        let meta = read_field(&output, FieldKind::Distance).expect("a field").meta;
        let shift = |key: &str| meta["zero_set_shift"][key].as_f64().expect("a number");
        println!("{name}: {meta}");
        assert!(shift("mean") < 0.01 && shift("p99") < 0.05, "{name}: {meta}");
        if is_plain {
            assert_eq!(meta["components"], meta["components_before"]);
            assert_eq!(meta["cavities"], meta["cavities_before"]);
        }
    }
}

#[test]
fn a_label_that_fills_the_volume_is_a_block_at_any_scale() {
    let folder = tempfile::tempdir().expect("folder");
    let (input, output) = (folder.path().join("full.nrrd"), folder.path().join("f.vti"));
    write_nrrd(&input, [16, 16, 16], |_, _, _| 1.0);
    let (input, path) = (input.to_str().expect("text"), output.to_str().expect("text"));
    for scale in [&[][..], &["--scale-for-size", "2"], &["--scale-for-vertices", "300"]] {
        let run = distfield(&[&[input, "-o", path, "--labels", "1", "--force"], scale].concat());
        assert_eq!(run.status.code(), Some(0), "{scale:?}: {}", String::from_utf8_lossy(&run.stderr));
        let meta = read_field(&output, FieldKind::Distance).expect("a field").meta;
        let volume = meta["volume"].as_f64().expect("a volume");
        assert!((volume / 4096.0 - 1.0).abs() < 0.005, "{scale:?}: {volume}");
    }
}
