//! Reads and writes the files in which stages exchange particles: a bincode payload in a container
//! with kind, version, length and checksum.
//!
//! The container is little-endian: magic (8 bytes), kind (u32), format version (u32), length of the
//! payload (u64), BLAKE3 hash of the payload (32 bytes), payload. The payload contains the particle
//! set, the metadata and history as JSON strings, and the extra bytes of checkpoints, in bincode
//! with fixed-width little-endian integers. In version 2 (several materials), the strata follow the
//! extra bytes.

use crate::error::{Error, Result};
use crate::output::write_atomically;
use isoparticles_field::materials::Stratum;
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_file::history::History;
use isoparticles_file::limit::check_memory;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io::{self, Read, Write};
use std::path::Path;

/// First bytes of every particle file.
pub const MAGIC: [u8; 8] = *b"ISOPART\n";
/// Container version of files with a single object.
const VERSION: u32 = 1;
/// Container version of files with several materials.
const VERSION_OF_STRATA: u32 = 2;
/// Size in bytes of the header before the payload: 8 + 4 + 4 + 8 + 32.
const HEADER_BYTES: usize = 56;

/// The type of the particles in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParticleKind {
    /// Initial particles, written by `seed`.
    Seeds,
    /// Settled particles, written by `particles`.
    Particles,
    /// Particles that are not yet settled, with the state needed to resume the run; written by
    /// `particles`.
    Checkpoint,
}

impl ParticleKind {
    const ALL: [Self; 3] = [Self::Seeds, Self::Particles, Self::Checkpoint];

    /// Returns the name of the file kind.
    pub fn name(self) -> &'static str {
        match self {
            Self::Seeds => "seeds",
            Self::Particles => "particles",
            Self::Checkpoint => "checkpoint",
        }
    }

    /// Returns the stage that writes files of this kind.
    pub fn stage(self) -> &'static str {
        match self {
            Self::Seeds => "seed",
            Self::Particles | Self::Checkpoint => "particles",
        }
    }

    fn number(self) -> u32 {
        match self {
            Self::Seeds => 1,
            Self::Particles => 2,
            Self::Checkpoint => 3,
        }
    }
}

/// The contents of a particle file.
#[derive(Clone, Debug, PartialEq)]
pub struct ParticleFile {
    /// The type of the particles.
    pub kind: ParticleKind,
    /// The particles.
    pub particles: ParticleSet,
    /// The strata of the particles; `None` for a single object.
    pub strata: Option<Strata>,
    /// Metadata of the stage that wrote the file.
    pub meta: Value,
    /// The history of the file.
    pub history: History,
    /// Bytes that only the writing stage interprets. Empty except in checkpoints.
    pub extra: Vec<u8>,
}

#[derive(Serialize)]
struct PayloadOut<'a> {
    particles: &'a ParticleSet,
    meta: String,
    history: String,
    extra: &'a [u8],
}

/// The decoded payload. Strings are decoded as byte vectors, which have the same encoding. For a
/// string, bincode would allocate the declared length before it checks the amount of data.
#[derive(Deserialize)]
struct PayloadIn {
    particles: ParticleSet,
    meta: Vec<u8>,
    history: Vec<u8>,
    extra: Vec<u8>,
}

fn configuration() -> impl bincode::config::Config {
    bincode::config::standard().with_fixed_int_encoding().with_little_endian()
}

impl ParticleFile {
    /// Writes the particles to a file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_atomically(path, |file| self.encode(file))
    }

    /// Writes the bytes of the file.
    ///
    /// # Errors
    /// If `file` returns an error, or if the particles cannot be encoded.
    pub fn encode(&self, file: &mut dyn Write) -> io::Result<()> {
        let payload = PayloadOut {
            particles: &self.particles,
            meta: serde_json::to_string(&self.meta)?,
            history: serde_json::to_string(&self.history)?,
            extra: &self.extra,
        };
        let mut payload = bincode::serde::encode_to_vec(&payload, configuration()).map_err(io::Error::other)?;
        if let Some(strata) = &self.strata {
            payload.extend(bincode::serde::encode_to_vec(strata, configuration()).map_err(io::Error::other)?);
        }
        let version = if self.strata.is_some() { VERSION_OF_STRATA } else { VERSION };
        file.write_all(&MAGIC)?;
        file.write_all(&self.kind.number().to_le_bytes())?;
        file.write_all(&version.to_le_bytes())?;
        file.write_all(&(payload.len() as u64).to_le_bytes())?;
        file.write_all(blake3::hash(&payload).as_bytes())?;
        file.write_all(&payload)
    }
}

/// Reads particles. Returns an error if their kind is not in `accepted`, or if the file is damaged.
pub fn read_particles(path: &Path, accepted: &[ParticleKind]) -> Result<ParticleFile> {
    let container = Container { path, accepted };
    let (kind, version, payload) = container.read()?;
    let damaged = |what: &str| container.damaged(what);
    let undecodable = |error: bincode::error::DecodeError| damaged(&format!("cannot be decoded: {error}"));
    let (decoded, mut used): (PayloadIn, usize) =
        bincode::serde::decode_from_slice(&payload, configuration()).map_err(undecodable)?;
    let mut strata = None;
    if version == VERSION_OF_STRATA {
        let (own, more): (Strata, usize) =
            bincode::serde::decode_from_slice(&payload[used..], configuration()).map_err(undecodable)?;
        strata = Some(own);
        used += more;
    }
    if used != payload.len() {
        return Err(damaged("has extra bytes after its last particle"));
    }
    check_particles(&decoded.particles).map_err(damaged)?;
    if let Some(strata) = &strata {
        check_strata(strata, decoded.particles.positions.len()).map_err(damaged)?;
    }
    let meta = serde_json::from_slice(&decoded.meta).map_err(|_| damaged("its metadata cannot be read"))?;
    let history = serde_json::from_slice(&decoded.history).map_err(|_| damaged("its history cannot be read"))?;
    Ok(ParticleFile { kind, particles: decoded.particles, strata, meta, history, extra: decoded.extra })
}

/// The path of a particle file, and the kinds that the reading stage accepts.
struct Container<'a> {
    path: &'a Path,
    accepted: &'a [ParticleKind],
}

impl Container<'_> {
    /// Reads and checks the container. Returns the kind, the version and the payload.
    fn read(&self) -> Result<(ParticleKind, u32, Vec<u8>)> {
        let cannot = |error: io::Error| Error::file(self.path, "read", &error, "check the name of the particle file");
        let mut file = std::fs::File::open(self.path).map_err(cannot)?;
        let length = file.metadata().map_err(cannot)?.len();
        let mut header = Vec::new();
        Read::take(&mut file, HEADER_BYTES as u64).read_to_end(&mut header).map_err(cannot)?;
        if !header.starts_with(&MAGIC) {
            return Err(self.not_accepted("is not a particle file of this program"));
        }
        let header: [u8; HEADER_BYTES] = header.try_into().map_err(|_| self.truncated())?;
        let word = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
        let (number, version) = (word(8), word(12));
        if ![VERSION, VERSION_OF_STRATA].contains(&version) {
            let what =
                format!("has format version {version}; this program reads versions {VERSION} and {VERSION_OF_STRATA}");
            return Err(self.refused(&what, "other versions store the data differently"));
        }
        let kind = ParticleKind::ALL.into_iter().find(|kind| kind.number() == number);
        let kind = kind.filter(|kind| self.accepted.contains(kind)).ok_or_else(|| {
            let found = kind.map_or(format!("particles of the unknown kind {number}"), |kind| kind.name().to_owned());
            self.not_accepted(&format!("contains {found}"))
        })?;
        let promised = u64::from(word(16)) | u64::from(word(20)) << 32;
        let found = length.saturating_sub(HEADER_BYTES as u64);
        if found < promised {
            return Err(self.truncated());
        }
        if found > promised {
            let what = format!("has {} extra bytes at its end", found - promised);
            return Err(self.refused(&what, "other data was appended to it"));
        }
        check_memory(self.path, promised.saturating_mul(2))?;
        let mut payload = Vec::new();
        file.read_to_end(&mut payload).map_err(cannot)?;
        if blake3::hash(&payload).as_bytes() != &header[24..] {
            return Err(self.damaged("does not match its checksum"));
        }
        Ok((kind, version, payload))
    }

    fn refused(&self, what: &str, why: &str) -> Error {
        let stage = self.accepted.first().map_or("seed", |kind| kind.stage());
        Error::of_file(self.path, what, why, format!("run {stage} again"))
    }

    fn not_accepted(&self, what: &str) -> Error {
        let names: Vec<&str> = self.accepted.iter().map(|kind| kind.name()).collect();
        self.refused(what, &format!("this stage reads {}", names.join(" or ")))
    }

    fn truncated(&self) -> Error {
        self.refused("is truncated", "some of its particles are missing")
    }

    fn damaged(&self, what: &str) -> Error {
        self.refused(what, "the file is damaged")
    }
}

/// Checks the properties that all stages require: arrays of equal length, finite values and
/// positive sizes.
fn check_particles(set: &ParticleSet) -> std::result::Result<(), &'static str> {
    let count = set.positions.len();
    let lengths = [set.normals.len(), set.sizes.len(), set.energies.len(), set.lambdas.len()];
    if lengths.iter().any(|&length| length != count) {
        return Err("has arrays of different lengths");
    }
    let finite = set.positions.iter().all(|p| p.is_finite())
        && set.normals.iter().all(|n| n.is_finite())
        && set.energies.iter().chain(&set.lambdas).all(|x| x.is_finite());
    if !finite {
        return Err("contains a particle with a value that is not finite");
    }
    if set.sizes.iter().any(|&size| !(size > 0.0 && size.is_finite())) {
        return Err("contains a particle with a target edge length that is not positive");
    }
    Ok(())
}

/// Checks the properties that all stages require: one valid stratum per particle, particles in
/// ascending order of stratum dimension, and segments whose ends lie on junction curves or points.
fn check_strata(strata: &Strata, count: usize) -> std::result::Result<(), &'static str> {
    if strata.of.len() != count {
        return Err("its numbers of strata and particles differ");
    }
    if !strata.of.iter().all(Stratum::is_valid) {
        return Err("has a stratum that is not between two to four different materials");
    }
    if !strata.of.is_sorted_by_key(Stratum::dimension) {
        return Err("its strata are not sorted by dimension");
    }
    let is_below_interfaces = |&end: &u32| strata.of.get(end as usize).is_some_and(|stratum| stratum.dimension() < 2);
    if !strata.segments.as_flattened().iter().all(is_below_interfaces) {
        return Err("has a segment of a junction curve with an end that is not on a junction");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_field::materials::MaterialId;
    use isoparticles_volume::Geometry;

    fn set() -> ParticleSet {
        ParticleSet {
            geometry: Geometry::axis_aligned([5, 6, 7], DVec3::new(0.5, 1.0, 1.5)),
            positions: vec![DVec3::new(1.0, 2.0, 3.0), DVec3::new(0.1, 0.2, 0.3)],
            normals: vec![DVec3::X, DVec3::NEG_Z],
            sizes: vec![0.7, 1.3],
            energies: vec![0.0, 0.71],
            lambdas: vec![0.1, 1e-5],
        }
    }

    fn history() -> History {
        History {
            tool: "seed".to_owned(),
            version: "0.1.0".to_owned(),
            command_line: "seed case.distfield.vti".to_owned(),
            parameters: serde_json::json!({"seed": 7}),
            inputs: Vec::new(),
        }
    }

    fn seeds(strata: Option<Strata>) -> ParticleFile {
        let (kind, meta, extra) = (ParticleKind::Seeds, Value::Null, Vec::new());
        ParticleFile { kind, particles: set(), strata, meta, history: history(), extra }
    }

    #[test]
    fn particles_come_back_bit_for_bit() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("case.seeds.bin");
        let meta = serde_json::json!({"components": 2});
        let file = ParticleFile { kind: ParticleKind::Checkpoint, meta, extra: vec![1, 2, 3], ..seeds(None) };
        file.write(&path).expect("written");
        let read = read_particles(&path, &[ParticleKind::Seeds, ParticleKind::Checkpoint]).expect("read");
        assert_eq!(read, file);
    }

    fn stratum(ids: &[u16]) -> Stratum {
        Stratum::new(&ids.iter().map(|&id| MaterialId(id)).collect::<Vec<_>>()).expect("valid")
    }

    #[test]
    fn strata_come_back_and_those_that_do_not_fit_are_refused() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("case.seeds.bin");
        let back = |strata: &Strata| {
            seeds(Some(strata.clone())).write(&path).expect("written");
            read_particles(&path, &[ParticleKind::Seeds])
        };
        let (point, curve, interface) = (stratum(&[0, 1, 2, 3]), stratum(&[0, 1, 2]), stratum(&[1, 2]));
        let good = Strata { of: vec![point, curve], segments: vec![[0, 1]] };
        assert_eq!(back(&good).expect("read").strata, Some(good));
        seeds(None).write(&path).expect("written");
        assert_eq!(read_particles(&path, &[ParticleKind::Seeds]).expect("read").strata, None);
        for (wrong, said) in [
            (Strata { of: vec![point], segments: Vec::new() }, "numbers of strata and particles differ"),
            (Strata { of: vec![interface, curve], segments: Vec::new() }, "strata are not sorted by dimension"),
            (Strata { of: vec![curve, interface], segments: vec![[0, 1]] }, "segment"),
            (Strata { of: vec![curve, curve], segments: vec![[0, 2]] }, "segment"),
        ] {
            let error = back(&wrong).expect_err(said);
            assert!(error.what.contains(said), "{error}");
        }
    }

    #[test]
    fn the_wrong_kind_names_the_stage_to_run() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("case.seeds.bin");
        seeds(None).write(&path).expect("written");
        let error = read_particles(&path, &[ParticleKind::Particles]).expect_err("seeds");
        assert!(error.what.contains("seeds") && error.next.contains("run particles again"), "{error}");
        let mut bytes = std::fs::read(&path).expect("bytes");
        bytes[12] = 9;
        std::fs::write(&path, &bytes).expect("written");
        let error = read_particles(&path, &[ParticleKind::Seeds]).expect_err("version 9");
        assert!(error.what.contains("version 9") && error.next.contains("run seed again"), "{error}");
    }

    #[test]
    fn truncated_extended_and_corrupted_files_are_errors() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("case.seeds.bin");
        seeds(None).write(&path).expect("written");
        let whole = std::fs::read(&path).expect("bytes");
        let refused = |bytes: &[u8]| {
            std::fs::write(&path, bytes).expect("written");
            read_particles(&path, &[ParticleKind::Seeds]).is_err()
        };
        for length in 0..whole.len() {
            assert!(refused(&whole[..length]), "cut to {length} bytes");
        }
        assert!(refused(&[&whole[..], &[0]].concat()));
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 1;
            assert!(refused(&bytes), "byte {at} changed");
        }
    }
}
