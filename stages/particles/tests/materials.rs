//! Tests of the program on multi-material files: results, resuming, and rejected inputs.

use glam::DVec3;
use isoparticles_field::materials::{
    Indicator, Indicators, Material, MaterialId, Materials, Stratum, ball, maximum, negative,
};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_field::random::uniform;
use isoparticles_field::spline::Jet;
use isoparticles_particles::INITIAL_LAMBDA;
use isoparticles_stage::field_file::{Field, FieldKind};
use isoparticles_stage::history::History;
use isoparticles_stage::materials_file::{MaterialsFile, Shown};
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind, read_particles};
use isoparticles_volume::{Geometry, Image};
use serde_json::Value;
use std::path::PathBuf;
use std::process::{Command, Output};

const CENTRE: DVec3 = DVec3::splat(12.0);

/// Input files: a ball of radius 5 mm inside a ball of radius 8 mm, with seeds for h = 1.2 mm on
/// both interfaces, and the distance field of the outer ball alone.
struct Files {
    folder: tempfile::TempDir,
}

impl Files {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let geometry = Geometry::axis_aligned([25; 3], DVec3::ONE);
        let history = History {
            tool: "seed".to_owned(),
            version: "0.1.0".to_owned(),
            command_line: String::new(),
            parameters: Value::Null,
            inputs: Vec::new(),
        };
        let path = |name: &str| folder.path().join(name);
        type Function = Box<dyn Fn(DVec3) -> Jet + Send + Sync>;
        let shell = maximum(ball(CENTRE, 8.0), negative(ball(CENTRE, 5.0)));
        let functions: [Function; 3] = [negative(ball(CENTRE, 8.0)), shell, ball(CENTRE, 5.0)];
        let parts = functions.iter().zip(["outside", "shell", "core"]).map(|(function, name)| {
            let image = Image::sampled(geometry.clone(), |p| function(p).value as f32);
            let (indicator, negative) = Indicator::new(&image, [0; 3], geometry.size, name == "outside");
            (Material { name: name.to_owned(), labels: Vec::new() }, indicator, negative)
        });
        let materials = Materials::new(geometry.clone(), parts.collect()).expect("parts of one grid");
        let nodes = geometry.voxel_count();
        let write = |name: &str, kind: FieldKind, image: Image<f32>| {
            Field { image: image.into(), meta: Value::Null, history: None, kind }.write(&path(name)).expect("written");
        };
        write("h.vti", FieldKind::Sizing, Image::filled(geometry.clone(), 1.2f32));
        let one = Image::sampled(geometry.clone(), |p| (p.distance(CENTRE) - 8.0) as f32);
        write("f.vti", FieldKind::Distance, one);
        let (positions, normals, sizes, energies, lambdas) = Default::default();
        let mut set = ParticleSet { geometry, positions, normals, sizes, energies, lambdas };
        let mut strata = Strata::default();
        for n in 0..700 {
            let way = (DVec3::new(uniform(1, 0, n), uniform(1, 1, n), uniform(1, 2, n)) - 0.5).normalize();
            let (own, radius) = if n % 4 == 0 { ([2, 1], 5.0) } else { ([1, 0], 8.0) };
            let own = own.map(MaterialId);
            let place = materials.place_on_interface(own, CENTRE + radius * way, 1.0, 1e-6);
            let (p, gradient) = place.expect("near its interface");
            set.positions.push(p);
            set.normals.push(gradient.normalize());
            set.sizes.push(1.2);
            set.energies.push(0.0);
            set.lambdas.push(INITIAL_LAMBDA);
            strata.of.push(Stratum::interface(own[0], own[1]));
        }
        let shown = Shown { material: vec![0; nodes], interface_distance: vec![0.0; nodes] };
        let file = MaterialsFile { materials, shown, meta: Value::Null, history: None };
        file.write(&path("m.vti")).expect("written");
        let (kind, meta, extra) = (ParticleKind::Seeds, Value::Null, Vec::new());
        let one = ParticleFile { kind, particles: set, strata: None, meta, history, extra };
        one.write(&path("one.bin")).expect("written");
        let many = ParticleFile { strata: Some(strata), ..one };
        many.write(&path("seeds.bin")).expect("written");
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, words: &str) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_particles"));
        command.current_dir(self.folder.path()).args(words.split_whitespace()).args(["--progress", "none"]);
        command.output().expect("the program runs")
    }

    fn particles(&self, name: &str) -> ParticleFile {
        read_particles(&self.path(name), &[ParticleKind::Particles]).expect("particles")
    }
}

const INPUT_FILES: &str = "seeds.bin --distfield m.vti --sizefield h.vti";

#[test]
fn interfaces_are_settled_and_a_broken_run_goes_on() {
    let files = Files::new();
    let whole = files.run(&format!("{INPUT_FILES} -o whole.bin --max-passes 30 --backend cpu"));
    assert!(whole.status.success(), "{}", String::from_utf8_lossy(&whole.stderr));
    let whole = files.particles("whole.bin");
    let strata = whole.strata.as_ref().expect("strata");
    for (radius, own) in [(8.0, [0, 1]), (5.0, [1, 2])] {
        let on = Stratum::interface(MaterialId(own[0]), MaterialId(own[1]));
        let of = || whole.particles.positions.iter().zip(&strata.of).filter(|(_, other)| **other == on);
        assert!(of().all(|(p, _)| (p.distance(CENTRE) - radius).abs() < 0.05), "{own:?}");
        let lattice = 4.0 * std::f64::consts::PI * radius * radius / (0.75f64.sqrt() * 1.44);
        let count = of().count() as f64;
        assert!((count / lattice - 0.97).abs() < 0.08, "{own:?}: {count}, the lattice has {lattice:.0}");
    }
    // the checkpoint of pass 20 remains after the run, so --resume repeats the later passes
    let kept = "--checkpoint c.bin --max-passes 30 --checkpoint-interval 20 --backend cpu";
    assert!(files.run(&format!("{INPUT_FILES} -o first.bin {kept}")).status.success());
    let resumed = files.run(&format!("{INPUT_FILES} -o resumed.bin {kept} --resume --levels 1"));
    let said = String::from_utf8_lossy(&resumed.stderr);
    assert!(resumed.status.success() && said.contains("resuming after pass 20"), "{said}");
    let resumed = files.particles("resumed.bin");
    assert!(resumed.particles == whole.particles && resumed.strata == whole.strata, "a resumed run differs");
}

#[test]
fn what_does_not_go_together_is_refused() {
    let files = Files::new();
    for (words, code, expected) in [
        ("one.bin --distfield m.vti --sizefield h.vti -o o.bin", 2, "one.bin: contains particles of one object"),
        (
            "seeds.bin --distfield f.vti --sizefield h.vti -o o.bin",
            2,
            "seeds.bin: contains particles of many materials",
        ),
        (&format!("{INPUT_FILES} -o o.bin --levels 2"), 2, "--levels 2"),
    ] {
        let ended = files.run(words);
        let said = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(code), "{words}: {said}");
        for part in [expected, "why it matters", "what to do"] {
            assert!(said.contains(part), "{words}: {said}");
        }
        assert!(!files.path("o.bin").exists());
    }
}
