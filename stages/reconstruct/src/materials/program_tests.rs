//! Tests of the program with many materials, from input files to output files.

use super::scenes::{self, Scene};
use crate::run::{Args, Inputs, compute, run};
use clap::Parser;
use isoparticles_field::materials::{Indicators, Materials};
use isoparticles_mesh::measure::measure;
use isoparticles_mesh::surface::{DataArray, SurfaceFile, read_surface};
use isoparticles_mesh::topology::analyse;
use isoparticles_stage::cli::{Context, Outcome};
use isoparticles_stage::history::History;
use isoparticles_stage::materials_file::{MaterialsFile, Shown};
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind};
use isoparticles_volume::Voxels;
use serde_json::{Value, json};
use std::path::PathBuf;

struct Case {
    folder: tempfile::TempDir,
}

fn history(tool: &str) -> History {
    History { tool: tool.into(), version: "0".into(), command_line: tool.into(), parameters: json!({}), inputs: vec![] }
}

impl Case {
    fn new(scene: &Scene, meta: &Value) -> Self {
        let case = Self { folder: tempfile::tempdir().expect("a folder") };
        let materials: Materials = scene.sampled(1.0);
        let count = materials.geometry().voxel_count();
        let place = |n: usize| {
            let [nx, ny, _] = materials.geometry().size;
            glam::DVec3::new((n % nx) as f64, (n / nx % ny) as f64, (n / nx / ny) as f64)
        };
        let material: Vec<u16> = (0..count).map(|n| materials.material_at(place(n)).0).collect();
        let shown = Shown { material, interface_distance: vec![0.0; count] };
        let (meta, from) = (meta.clone(), Some(history("distfield")));
        MaterialsFile { materials, shown, meta, history: from }.write(&case.path("f.vti")).expect("written");
        let (particles, strata) = scene.particles(1.5, 0.75);
        let (kind, meta, history) = (ParticleKind::Particles, Value::Null, history("particles"));
        let plain = ParticleFile { kind, particles, strata: None, meta, history, extra: Vec::new() };
        plain.write(&case.path("plain.bin")).expect("written");
        ParticleFile { strata: Some(strata), ..plain }.write(&case.path("p.bin")).expect("written");
        case
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn args(&self, words: &[&str]) -> Args {
        let path = |word: &&str| {
            let is_file = word.contains('.') && word.parse::<f64>().is_err() || *word == "each";
            if is_file { self.path(word).display().to_string() } else { (*word).to_owned() }
        };
        let args = Args::try_parse_from(std::iter::once("reconstruct".to_owned()).chain(words.iter().map(path)));
        args.expect("good options")
    }

    fn run(&self, words: &[&str]) -> isoparticles_stage::error::Result<Outcome> {
        run(&self.args(words), &Context::silent("reconstruct"))
    }

    fn surface(&self, name: &str) -> SurfaceFile {
        read_surface(&self.path(name)).expect("a surface")
    }
}

fn integers<'a>(arrays: &'a [DataArray], name: &str) -> &'a [i64] {
    match arrays.iter().find(|a| a.name == name).map(|a| &a.values) {
        Some(Voxels::I64(values)) => values,
        other => panic!("{name}: {other:?}"),
    }
}

#[test]
fn a_complex_and_each_of_its_surfaces_are_written() {
    let case = Case::new(&scenes::sectors(), &json!({"version": 1, "border": "cap"}));
    let outcome = case.run(&["p.bin", "--distfield", "f.vti", "-o", "s.vtp", "--each", "each"]).expect("made");
    assert_eq!(outcome, Outcome::Passed);
    let file = case.surface("s.vtp");
    let [inside, outside] =
        ["material_inside", "material_outside"].map(|name| integers(&file.surface.cell_data, name).to_vec());
    assert!(inside.iter().zip(&outside).all(|(a, b)| a > b && (0..4).contains(b) && *a < 4));
    assert_eq!(integers(&file.surface.point_data, "materials").iter().filter(|&&n| n == 4).count(), 2);
    assert_eq!(file.meta["materials"][2]["name"], "m2");
    assert_eq!(file.history.expect("known").inputs.len(), 2);
    for id in 1..4i64 {
        let own = case.surface(&format!("each/m{id}.vtp")).surface;
        let topology = analyse(&own.mesh);
        assert!(topology.is_closed_manifold() && topology.euler == 2 && measure(&own.mesh).volume > 600.0);
        // the vertices are those of the whole complex
        for (&v, p) in integers(&own.point_data, "vertex").iter().zip(&own.mesh.vertices) {
            assert_eq!(file.surface.mesh.vertices[v as usize], *p);
        }
        let count = inside.iter().zip(&outside).filter(|(a, b)| **a == id || **b == id).count();
        assert_eq!(own.mesh.triangles.len(), count);
    }
    case.run(&["p.bin", "--distfield", "f.vti", "-o", "s.ply", "--each", "each"]).expect("made");
    assert!(case.path("each/m1.ply").metadata().expect("there").len() > 1000);
}

#[test]
fn data_in_memory_gives_the_same_surfaces() {
    let case = Case::new(&scenes::two_balls(), &json!({"version": 1, "border": "cap"}));
    let args = case.args(&["p.bin", "--distfield", "f.vti", "-o", "s.vtp", "--each", "each"]);
    let context = Context::silent("reconstruct");
    let inputs = Inputs::read(&args, &context).expect("read");
    run(&args, &Context::silent("reconstruct")).expect("made");
    let [whole, first, second] = ["s.vtp", "each/m1.vtp", "each/m2.vtp"].map(|name| case.surface(name));
    drop(case);
    let made = compute(&args, inputs, &context).expect("made");
    assert_eq!((&made.surface, json!(made.meta)), (&whole.surface, whole.meta));
    let names: Vec<&str> = made.each().map(|own| own.name).collect();
    assert_eq!(names, ["m1", "m2"]);
    for (own, file) in made.each().zip([first, second]) {
        assert_eq!((own.surface, json!(own.meta)), (file.surface, file.meta));
    }
}

#[test]
fn invalid_input_is_refused_and_failed_checks_are_reported() {
    let case = Case::new(&scenes::two_balls(), &json!({"version": 1, "border": "cap"}));
    let refused = |words: &[&str], said: &str| {
        let error = case.run(words).expect_err(said);
        assert!(format!("{} {}", error.what, error.why).contains(said), "{error:?}");
        assert!(!case.path("s.vtp").exists());
    };
    refused(&["p.bin", "--distfield", "f.vti", "-o", "s.vtp", "--method", "tight-cocone"], "tight-cocone");
    refused(&["plain.bin", "--distfield", "f.vti", "-o", "s.vtp"], "no strata");
    let open = Case::new(&scenes::two_balls(), &json!({"version": 1, "border": "open"}));
    let error = open.run(&["p.bin", "--distfield", "f.vti", "-o", "s.vtp"]).expect_err("open");
    assert!(error.what.contains("open at the border"), "{error:?}");
    let words = ["p.bin", "--distfield", "f.vti", "-o", "s.vtp", "--min-radius-ratio", "1"];
    let Outcome::ChecksFailed(failed) = case.run(&words).expect("made") else { panic!("passed") };
    assert!(failed.len() == 1 && failed[0].contains("radius ratio"), "{failed:?}");
    assert!(case.path("s.offending.vtp").exists());
}
