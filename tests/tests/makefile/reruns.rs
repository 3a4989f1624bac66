//! Tests which stages run again after a change.

use super::support::{binaries, listing, run};
use super::{Case, PARAMETERS, STAGES};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::SystemTime;

const ALL: [&str; 5] = ["distfield", "sizefield", "seed", "particles", "reconstruct"];

#[test]
fn one_parameter_reruns_exactly_the_stages_that_depend_on_it() {
    let case = Case::new();
    case.surface(&PARAMETERS).expect_success("make surface");
    assert_eq!(case.reran(&PARAMETERS), [] as [&str; 0], "nothing changed");
    assert_eq!(
        case.reran(&["ISO=100", "SIZE=2.5", "VERBOSITY=-v", "THREADS=1"]),
        [] as [&str; 0],
        "how loud and how many"
    );
    assert_eq!(case.reran(&["ISO=100", "SIZE=2.5", "BACKEND=cpu"]), ["particles", "reconstruct"]);
    let reseeded = ["ISO=100", "SIZE=2.5", "BACKEND=cpu", "SEED=3"];
    assert_eq!(case.reran(&reseeded), ["seed", "particles", "reconstruct"]);
    let resized = ["ISO=100", "SIZE=2.4", "BACKEND=cpu", "SEED=3"];
    // SIZE is above 0.75 voxel, so distfield derives its scale from it.
    assert_eq!(case.reran(&resized), ["distfield", "sizefield", "seed", "particles", "reconstruct"]);
    let graded = ["ISO=100", "SCALE=0", "EPSILON=0.4", "MAX_SIZE=3", "BACKEND=cpu", "SEED=3"];
    assert_eq!(case.reran(&graded).first(), Some(&"distfield"));
    let finer = ["ISO=100", "SCALE=0", "EPSILON=0.3", "MAX_SIZE=3", "BACKEND=cpu", "SEED=3"];
    assert_eq!(case.reran(&finer), ["sizefield", "seed", "particles", "reconstruct"]);
    let another = ["ISO=120", "EPSILON=0.4", "MAX_SIZE=3", "BACKEND=cpu", "SEED=3"];
    assert_eq!(case.reran(&another), ALL);
    let another = [&another[..], &["SPACE=ras"]].concat();
    assert_eq!(case.reran(&another), ALL);
    // A missing output is made again, and all later stages run again.
    std::fs::remove_file(case.file("particles.bin")).unwrap();
    case.surface(&another).expect_success("make surface");
    assert_eq!(case.status()["stages"][3]["made"], true);
    assert_eq!(case.status()["stages"][2]["made"], false);
    assert_eq!(case.status()["stages"][4]["made"], true);
}

/// Reruns depend on the content of a file, not on its modification time, so touching a file has no
/// effect.
#[test]
fn a_touched_input_reruns_nothing_and_a_changed_one_everything() {
    let case = Case::new();
    case.surface(&PARAMETERS).expect_success("make surface");
    std::fs::File::options().append(true).open(&case.volume).unwrap().set_modified(SystemTime::now()).unwrap();
    assert_eq!(case.reran(&PARAMETERS), [] as [&str; 0]);
    super::support::write_phantom(
        &case.volume,
        isoparticles_tests::scene::Shape::Ellipsoid,
        &isoparticles_volume::Geometry::axis_aligned([24; 3], glam::DVec3::ONE),
        super::Kind::Scalar,
    );
    assert_eq!(case.reran(&PARAMETERS), ALL);
}

#[test]
fn a_file_that_an_option_names_is_a_prerequisite() {
    let case = Case::new();
    let mask = case.folder.path().join("the mask.nrrd");
    super::ball(&mask);
    let options = format!("SIZEFIELD_OPTIONS=--refine 'mask:{}=1.5'", mask.display());
    let variables = ["ISO=100", "MIN_SIZE=2", "VERBOSITY=-q", &options];
    case.surface(&variables).expect_success("make surface");
    assert_eq!(case.reran(&variables), [] as [&str; 0]);
    super::support::write_phantom(
        &mask,
        isoparticles_tests::scene::Shape::Ellipsoid,
        &isoparticles_volume::Geometry::axis_aligned([24; 3], glam::DVec3::ONE),
        super::Kind::Scalar,
    );
    assert_eq!(case.reran(&variables), ["sizefield", "seed", "particles", "reconstruct"]);
    let status = case.status();
    let roles: Vec<_> = status["inputs"].as_array().unwrap().iter().map(|input| input["role"].clone()).collect();
    assert_eq!(roles, ["volume", "named in SIZEFIELD_OPTIONS"]);
    // The tetrahedra depend on the volume that provides the labels, so a change to it must cause
    // new tetrahedra.
    let labels = format!("TETMESH_OPTIONS=--labels-volume='{}'", mask.display());
    case.mesh(0, &[&labels]);
    let made = |case: &Case| case.status()["stages"][5]["made"].clone();
    case.mesh(0, &[&labels]);
    assert_eq!(made(&case), false);
    super::ball(&mask);
    case.mesh(0, &[&labels]);
    assert_eq!(made(&case), true);
}

#[test]
fn the_data_file_of_a_detached_header_is_a_prerequisite() {
    let mut case = Case::new();
    let voxels = |radius: f32| {
        let mut bytes = Vec::new();
        for index in 0..16 * 16 * 16 {
            let at = [index % 16, index / 16 % 16, index / 256].map(|i| i as f32 - 7.5);
            let distance = at.iter().map(|x| x * x).sum::<f32>().sqrt();
            bytes.extend_from_slice(&(radius - distance).to_le_bytes());
        }
        bytes
    };
    let data = case.folder.path().join("voxels.raw");
    std::fs::write(&data, voxels(5.0)).unwrap();
    case.volume = case.folder.path().join("ball.nhdr");
    let header =
        "NRRD0004\ntype: float\ndimension: 3\nsizes: 16 16 16\nspacings: 1 1 1\nendian: little\nencoding: raw\n";
    std::fs::write(&case.volume, format!("{header}data file: voxels.raw\n")).unwrap();
    let variables = ["ISO=0", "SIZE=2", "VERBOSITY=-q"];
    case.surface(&variables).expect_success("make surface");
    assert_eq!(case.reran(&variables), [] as [&str; 0]);
    std::fs::write(&data, voxels(6.0)).unwrap();
    assert_eq!(case.reran(&variables), ALL);
}

#[test]
fn a_program_built_anew_to_the_same_bytes_reruns_nothing() {
    let case = Case::new();
    let programs = case.folder.path().join("bin");
    std::fs::create_dir(&programs).unwrap();
    let copy = || {
        for name in STAGES.map(|(name, _)| name).into_iter().chain(["isoparticles-case"]) {
            std::fs::copy(binaries().join(name), programs.join(name)).unwrap();
        }
    };
    copy();
    let bin = format!("BIN={}", programs.display());
    let variables = ["ISO=100", "SIZE=2.5", "VERBOSITY=-q", &bin];
    case.surface(&variables).expect_success("make surface");
    copy();
    assert_eq!(case.reran(&variables), [] as [&str; 0]);
    // An extra byte at the end changes the program's hash but not its behaviour.
    use std::io::Write;
    std::fs::File::options().append(true).open(programs.join("particles")).unwrap().write_all(&[0]).unwrap();
    assert_eq!(case.reran(&variables), ["particles", "reconstruct"]);
}

/// The files of the page make no tetrahedra, so a change to them must not cause a new tetrahedral
/// mesh.
#[test]
fn the_files_of_the_tetrahedra_leave_out_the_page() {
    let planned =
        run(Case::new().command("mesh", &["ISO=100", "-n"]).arg("HXT=no")).expect_success("make -n mesh").stdout;
    let (_, rest) = planned.split_once("--tetmesh-files").expect("the files of the tetrahedra");
    let (files, _) = rest.split_once("--page-files").expect("the files of the page");
    assert!(
        files.contains("requirements.lock") && files.contains("pipeline.py") && files.contains("fill.py"),
        "{files}"
    );
    assert!(!files.contains("page/"), "{files}");
}

/// If make is stopped during `particles`, no particle file is left. The next run must give the same
/// particles as an uninterrupted run.
#[test]
#[cfg(unix)]
fn a_stopped_run_is_finished_by_the_next() {
    use std::os::unix::process::CommandExt;
    let (stopped, unbroken) = (Case::new(), Case::new());
    let options = "PARTICLES_OPTIONS=--max-passes 300 --energy-tolerance 0";
    let variables = ["ISO=100", "SIZE=1.2", "VERBOSITY=-q", options];
    let mut command = stopped.command("surface", &variables);
    // As with Ctrl-C, the signal must reach make and all its programs, so they get a process group
    // of their own.
    command.process_group(0);
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("make");
    let checkpoint = stopped.file("checkpoint.bin");
    let mut waited = 0;
    while !checkpoint.exists() {
        assert!(child.try_wait().unwrap().is_none() && waited < 6000, "no checkpoint after {waited} x 10 ms");
        std::thread::sleep(std::time::Duration::from_millis(10));
        waited += 1;
    }
    let killed = Command::new("sh").args(["-c", &format!("kill -s INT -- -{}", child.id())]).status().expect("sh");
    assert!(killed.success());
    assert!(!child.wait().expect("make ends").success(), "make must not call a stopped run a success");
    // After the signal, make exits without waiting for its child processes.
    while !stopped.has("report.html") {
        assert!(waited < 12000, "a stopped case has its page, too: {}", stopped.status());
        std::thread::sleep(std::time::Duration::from_millis(10));
        waited += 1;
    }
    let status = stopped.status();
    assert_eq!(status["verdict"], "interrupted", "{status}");
    assert_eq!(status["stages"][3]["kept"].as_array().unwrap().len(), 2, "the checkpoint and its log: {status}");
    assert!(!stopped.has("particles.bin"), "{:?}", listing(&stopped.out().join("ball")));

    stopped.surface(&variables).expect_success("the second run");
    unbroken.surface(&variables).expect_success("the unbroken run");
    assert!(!checkpoint.exists(), "a finished run needs no checkpoint");
    // The files differ because their histories contain the paths of the inputs. Only the particles
    // can be compared.
    let particles = |file: &Path| {
        use isoparticles_stage::particle_file::{ParticleKind, read_particles};
        read_particles(file, &[ParticleKind::Particles]).expect("particles").particles
    };
    let [one, other] = [&stopped, &unbroken].map(|case| particles(&case.file("particles.bin")));
    assert!(one == other, "the resumed run differs from the unbroken one");
}

/// A change of the content of a mask in CROP is detected, as for INPUT.
#[test]
fn another_region_or_resolution_remakes_the_case() {
    let case = Case::new();
    let distfield = |variables: &[&str]| {
        let told = [&["ISO=100", "SCALE=0", "VERBOSITY=-q"], variables].concat();
        run(&mut case.command("distfield", &told)).expect_success("make distfield");
        std::fs::metadata(case.file("distfield.vti")).and_then(|file| file.modified()).expect("a field")
    };
    let mask = case.folder.path().join("a mask.nrrd");
    std::fs::copy(&case.volume, &mask).unwrap();
    let masked = format!("CROP={}", mask.display());
    let choices: [&[&str]; 5] =
        [&["CROP=voxels:..,..,..11"], &["CROP=mm:..,..,..12"], &[], &["DOWNSAMPLE=2"], &[&masked, "DOWNSAMPLE=2"]];
    for choice in choices {
        let made = distfield(choice);
        assert_eq!(distfield(choice), made, "nothing changed");
    }
    assert_eq!(case.status()["parameters"]["DOWNSAMPLE"], "2");
    let made = distfield(choices[4]);
    super::ball(&case.volume);
    assert_eq!(distfield(choices[4]), made, "the same content");
    let half = isoparticles_volume::Geometry::axis_aligned([24, 24, 12], glam::DVec3::ONE);
    super::support::write_phantom(&mask, isoparticles_tests::scene::Shape::Ellipsoid, &half, super::Kind::Label);
    assert_ne!(distfield(choices[4]), made, "another mask");
    run(&mut case.command("distfield", &["ISO=100", "CROP=mm:5..1,..,.."])).expect_error(2, &["ends before it starts"]);
    let info = run(&mut case.command("info", &["CROP=voxels:0..9,..,..", "DOWNSAMPLE=2"]));
    assert!(info.stdout.contains("5 x 12 x 12"), "{}{}", info.stdout, info.stderr);
}
