//! Options for the volume to read, the part of it to keep, and the resolution. `distfield`,
//! `isoparticles-volume` and the Python package share them.

use crate::kind::{Kind, judge};
use crate::survey::Survey;
use isoparticles_stage::cli::values::{positive, significant};
use isoparticles_stage::cli::{Context, FILES};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::history::file_name;
use isoparticles_volume::{Crop, Geometry, Pooling, ReadOptions, Volume, VoxelBox, read_volume_with};
use serde_json::{Value, json};
use std::path::PathBuf;

/// The volume to read.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct InputArgs {
    /// Volume to read: NRRD (.nrrd, .nhdr, .seg.nrrd), NIfTI (.nii, .nii.gz), Analyze (.hdr),
    /// FreeSurfer (.mgz, .mgh), MetaImage (.mha, .mhd), TIFF (.tif), NumPy (.npy), VTK image
    /// (.vti), DICOM (.dcm: multi-frame image, segmentation or contours), or a folder of DICOM
    /// slices, of TIFF slices or of masks, one file per object
    #[arg(value_name = "VOLUME", help_heading = FILES)]
    pub path: PathBuf,
    /// Series to read if a DICOM folder contains several, or part of a multi-frame file, given by
    /// its description, number or UID
    #[arg(long, value_name = "NAME", help_heading = FILES)]
    pub series: Option<String>,
    /// Distance between voxel centres along the axes, mm, for a file that does not contain it: one
    /// number for all axes, or three
    #[arg(long, value_name = "X[,Y,Z]", value_parser = spacing, help_heading = FILES)]
    pub spacing: Option<Spacing>,
    /// Region to keep: mm:x0..x1,y0..y1,z0..z1 is a box in world coordinates, and
    /// voxels:i0..i1,j0..j1,k0..k1 contains the numbers of the first and last voxel, from 0. Ends
    /// may be missing (mm:..50,..,10..). Anything else is a mask file: the region is the box around
    /// its voxels other than 0. Voxels with their centre in the region are kept. An object that the
    /// region cuts is treated as at the border of the volume (distfield --border)
    #[arg(long, value_name = "REGION", help_heading = FILES)]
    pub crop: Option<Crop>,
    /// Join each block of N x N x N voxels (N,M,K: of N x M x K) to one voxel, after --crop: the
    /// mean for a scan (--iso), and the most frequent label for a label map (the smallest of
    /// several). Voxels at the far ends that do not fill a block are dropped
    #[arg(long, value_name = "N[,M,K]", value_parser = factors, help_heading = FILES)]
    pub downsample: Option<Factors>,
}

/// Distances between voxel centres, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spacing(pub [f64; 3]);

/// Number of voxels that are joined into one along each axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Factors(pub [usize; 3]);

/// Parses one or three values separated by commas.
fn one_or_three<T: Copy>(
    text: &str,
    parse: impl Fn(&str) -> std::result::Result<T, String>,
) -> std::result::Result<[T; 3], String> {
    let values: Vec<T> = text.split(',').map(|part| parse(part.trim())).collect::<std::result::Result<_, _>>()?;
    match values[..] {
        [one] => Ok([one; 3]),
        [x, y, z] => Ok([x, y, z]),
        _ => Err(format!("has {} values; write one for all axes, or three", values.len())),
    }
}

fn spacing(text: &str) -> std::result::Result<Spacing, String> {
    one_or_three(text, positive).map(Spacing)
}

fn factors(text: &str) -> std::result::Result<Factors, String> {
    let whole =
        |part: &str| part.parse().ok().filter(|&n| n >= 1).ok_or("must be whole numbers of at least 1".to_owned());
    one_or_three(text, whole).map(Factors)
}

impl InputArgs {
    /// Reads the whole volume.
    ///
    /// # Errors
    /// If the volume cannot be read.
    pub fn read(&self) -> Result<Volume> {
        let spacing = self.spacing.map(|Spacing(spacing)| spacing.into());
        Ok(read_volume_with(&self.path, &ReadOptions { series: self.series.as_deref(), spacing })?)
    }

    /// Reads the whole volume, and records it as an input of the run.
    ///
    /// # Errors
    /// If the volume cannot be read, or is also an output.
    pub fn load(&self, context: &Context) -> Result<Volume> {
        let _step = context.step("read");
        let volume = self.read()?;
        context.add_input(&self.path, None)?;
        Ok(volume)
    }

    /// Reads, crops and downsamples the volume, and records it as an input of the run. Prints the
    /// remarks of the reader. `kind` determines how blocks of voxels are joined; `None` detects the
    /// kind from the values.
    ///
    /// # Errors
    /// If the volume or the mask cannot be read, or if too few voxels would remain.
    pub fn load_part(&self, kind: Option<Kind>, context: &Context) -> Result<Volume> {
        let mut volume = self.load(context)?;
        volume.remarks.iter().for_each(|remark| context.warn(remark));
        if let Some(kept) = self.region(&volume.geometry, context)? {
            crop(&mut volume, kept, context);
        }
        if self.downsample.is_some() {
            let kind = kind
                .unwrap_or_else(|| judge(&Survey::of(&volume.voxels, &volume.geometry), volume.segments.len()).kind);
            self.downsample(&mut volume, kind, context)?;
        }
        Ok(volume)
    }

    /// Returns the box of voxels that `--crop` keeps. Records a mask as an input of the run.
    ///
    /// # Errors
    /// If the mask cannot be read, or if too few voxels would remain.
    pub fn region(&self, geometry: &Geometry, context: &Context) -> Result<Option<VoxelBox>> {
        let Some(crop) = &self.crop else { return Ok(None) };
        let kept = crop.locate(&self.path, geometry)?;
        if let Some(mask) = crop.mask() {
            context.add_input(mask, None)?;
        }
        Ok(Some(kept))
    }

    /// Joins blocks of voxels, if `--downsample` is given, and reports the new grid.
    ///
    /// # Errors
    /// If fewer than two voxels would remain along an axis.
    pub fn downsample(&self, volume: &mut Volume, kind: Kind, context: &Context) -> Result<()> {
        let Some(Factors(factors)) = self.downsample else { return Ok(()) };
        let _step = context.step("downsample");
        let before = volume.geometry.clone();
        if let Some(axis) = (0..3).find(|&axis| before.size[axis] / factors[axis] < 2) {
            return Err(Error::input(
                format!(
                    "{}: --downsample {} of {} voxels leaves fewer than two",
                    self.path.display(),
                    factors[axis],
                    before.size[axis]
                ),
                "a volume has at least two voxels along each axis",
                "set DOWNSAMPLE (--downsample) to a smaller number",
            ));
        }
        let (pooling, told) = match kind {
            Kind::Scan => (Pooling::Mean, "mean"),
            Kind::Labels => (Pooling::MostFrequent, "most frequent label"),
        };
        let blocks = before.downsampled(factors);
        let bytes: usize = volume.layers().map(|voxels| pooling.bytes(voxels.scalar_type())).sum();
        context.check_memory(
            bytes as f64 * blocks.voxel_count() as f64,
            &format!("{}: downsampling to {} voxels", self.path.display(), size(blocks.size)),
            "set DOWNSAMPLE (--downsample) to a larger number",
        )?;
        volume.downsample(factors, pooling);
        let after = &volume.geometry;
        context.add_row(
            "downsampled, voxels".to_owned(),
            format!("{} -> {} ({told})", size(before.size), size(after.size)),
        );
        context.add_row("  spacing, mm".to_owned(), format!("{} -> {}", lengths(&before), lengths(after)));
        let dropped: [usize; 3] = std::array::from_fn(|axis| before.size[axis] % factors[axis]);
        if dropped != [0; 3] {
            context.add_row("  dropped at the far ends, voxels".to_owned(), size(dropped));
        }
        context.report(
            "downsample",
            json!({
                "factors": factors, "pooling": if kind == Kind::Scan { "mean" } else { "most-frequent" },
                "size": [before.size, after.size], "spacing": [before.spacing, after.spacing], "dropped": dropped,
            }),
        );
        Ok(())
    }

    /// Adds the options that are set to the parameters of a run. The parameter for a mask is its
    /// file name.
    pub fn add_to(&self, parameters: &mut Value) {
        let given = [
            ("series", self.series.as_ref().map(|series| json!(series))),
            ("spacing", self.spacing.map(|Spacing(spacing)| json!(spacing))),
            ("crop", self.crop.as_ref().map(|crop| json!(crop.mask().map_or_else(|| crop.to_string(), file_name)))),
            ("downsample", self.downsample.map(|Factors(factors)| json!(factors))),
        ];
        for (key, value) in given {
            if let Some(value) = value {
                parameters[key] = value;
            }
        }
    }

    /// Returns the name of the volume for error messages, with the kept region.
    pub fn name(&self) -> String {
        match &self.crop {
            None => self.path.display().to_string(),
            Some(crop) => format!("{} (cropped to {crop})", self.path.display()),
        }
    }
}

/// Crops a volume and reports the kept part.
pub fn crop(volume: &mut Volume, kept: VoxelBox, context: &Context) {
    let _step = context.step("crop");
    let before = volume.geometry.clone();
    volume.crop(kept.low, kept.size());
    let after = &volume.geometry;
    let [low, high] = after.world_box([glam::DVec3::ZERO, after.upper_corner()]);
    let share = after.voxel_count() as f64 / before.voxel_count() as f64;
    let ranges = |low: [String; 3], high: [String; 3]| {
        let ranges: Vec<String> = low.into_iter().zip(high).map(|(low, high)| format!("{low}..{high}")).collect();
        ranges.join(", ")
    };
    let told = format!("{} of {} ({})", size(after.size), size(before.size), percent(share));
    context.add_row("cropped, voxels".to_owned(), told);
    context.add_row("  numbers".to_owned(), ranges(kept.low.map(|n| n.to_string()), kept.high.map(|n| n.to_string())));
    let coordinates = |corner: glam::DVec3| corner.to_array().map(|x| format!("{:.3}", x + 0.0));
    context.add_row("  centres, mm".to_owned(), ranges(coordinates(low), coordinates(high)));
    context.report(
        "crop",
        json!({ "voxels": [kept.low, kept.high], "centres": [low, high], "size": [before.size, after.size], "share": share }),
    );
}

/// Formats a share in percent.
pub fn percent(share: f64) -> String {
    format!("{} %", significant(100.0 * share))
}

fn size([nx, ny, nz]: [usize; 3]) -> String {
    format!("{nx} x {ny} x {nz}")
}

fn lengths(geometry: &Geometry) -> String {
    geometry.spacing.to_array().map(significant).join(" x ")
}
