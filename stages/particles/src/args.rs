//! Command-line options of the program and the [`Parameters`] that they specify. Options that are
//! not given take their values from [`Parameters::default`] or, with `--as-printed`, from
//! [`Parameters::as_printed`].

use crate::constants::{COARSE_CLOSING_PASSES, LARGEST_SPACING, LEAST_SPACING, REORDER_INTERVAL};
use crate::matching::check_levels;
use crate::settle::{Binning, Order, Parameters};
use clap::{Parser, ValueEnum};
use isoparticles_field::energy::lattice_energy;
use isoparticles_stage::cli::check::Known;
use isoparticles_stage::cli::values::{above_one, positive, share};
use isoparticles_stage::cli::{CommonArgs, FILES, METHOD, StageArgs};
use isoparticles_stage::error::{Error, Result};
use serde_json::{Value, json};
use std::fmt::Display;
use std::path::PathBuf;

/// Device that moves the particles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Backend {
    /// The first GPU that is not a software renderer, or the CPU if there is none.
    Auto,
    /// A GPU; the exit code is 3 if there is none.
    Gpu,
    /// All CPU cores (see --threads).
    Cpu,
}

/// Moves particles on F = 0 until they settle into a nearly hexagonal lattice with local spacing h
#[derive(Debug, Parser)]
#[command(
    name = "particles",
    version,
    override_usage = "particles [OPTIONS] --distfield <F.vti> --sizefield <S.vti> --output <P.bin> <seeds.bin>\n       \
        particles --list-adapters",
    after_help = "Example:\n  particles heart.seeds.bin --distfield heart.distfield.vti --sizefield heart.sizefield.vti \\\n      \
        -o heart.particles.bin --log heart.passes.csv\n\n\
        Paper: section 3, Eq. 1 to 5 and Algorithm 1. --as-printed follows the text of the paper, except for misprints (docs/developer/method.md). The \
        printed ideal energy, 3.462, is six times the ideal distance; it gives a lattice of 0.657 h with 2.3 times as many particles."
)]
pub struct Args {
    /// Seeds written by the seed stage
    #[arg(value_name = "seeds.bin", help_heading = FILES, required_unless_present = "list_adapters")]
    pub(crate) seeds: Option<PathBuf>,
    /// Distance field F from which the seeds were made, or the indicators of several materials
    #[arg(long, value_name = "F.vti", help_heading = FILES, required_unless_present = "list_adapters")]
    pub(crate) distfield: Option<PathBuf>,
    /// Size field h on the same grid
    #[arg(long, value_name = "S.vti", help_heading = FILES, required_unless_present = "list_adapters")]
    pub(crate) sizefield: Option<PathBuf>,
    /// Particle file to write
    #[arg(short, long, value_name = "P.bin", help_heading = FILES, required_unless_present = "list_adapters")]
    pub(crate) output: Option<PathBuf>,
    /// Write one line per pass to this file: energy, number of particles, insertions, deletions,
    /// lattice defects, time, level and more. The format is JSON Lines if the name ends in .jsonl,
    /// otherwise CSV
    #[arg(long, value_name = "FILE", help_heading = FILES)]
    pub(crate) log: Option<PathBuf>,
    /// Write a checkpoint to this file every --checkpoint-interval passes
    #[arg(long, value_name = "FILE", help_heading = FILES)]
    pub(crate) checkpoint: Option<PathBuf>,
    /// Continue from the checkpoint if it exists; the result is byte-identical to that of an
    /// uninterrupted run
    #[arg(long, requires = "checkpoint", help_heading = FILES)]
    pub(crate) resume: bool,
    /// Number of passes between checkpoints; a multiple of 10
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = interval, help_heading = FILES)]
    pub(crate) checkpoint_interval: u64,
    /// Device that moves the particles; with gpu, the exit code is 3 if there is no GPU
    #[arg(long, value_enum, default_value_t = Backend::Auto, help_heading = METHOD)]
    pub(crate) backend: Backend,
    /// GPU to use, selected by a case-insensitive part of its name (see --list-adapters). Software
    /// renderers are used only if selected by this option
    #[arg(long, value_name = "NAME", help_heading = METHOD)]
    pub(crate) adapter: Option<String>,
    /// Print the GPU adapters of this machine to stdout and exit
    #[arg(long, help_heading = METHOD)]
    pub(crate) list_adapters: bool,
    /// Measure the time of each GPU kernel with timestamp queries and include it in the report and
    /// the closing table
    #[arg(long, help_heading = METHOD)]
    pub(crate) profile: bool,
    /// Disable subgroup operations
    #[arg(long, hide = true)]
    pub(crate) no_subgroups: bool,
    /// Number of lanes per particle
    #[arg(long, hide = true, value_parser = clap::builder::PossibleValuesParser::new(["8", "16", "32"]))]
    pub(crate) team: Option<String>,
    /// Use the method as printed in the paper: options that are not given have the values marked
    /// "printed" below. The CPU does not support the printed --order bins
    #[arg(long, help_heading = METHOD)]
    as_printed: bool,
    #[arg(long, value_enum, help_heading = METHOD,
        help = told("Bins of the neighbour search on a GPU; the results differ only in the order of summation", |p| name(p.binning)))]
    binning: Option<Binning>,
    #[arg(long, value_enum, help_heading = METHOD,
        help = told("Order in which a GPU moves the particles of a pass; bins requires uniform bins", |p| name(p.order)))]
    order: Option<Order>,
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), help_heading = METHOD,
        help = told("Maximum number of passes on the last level, whose edge length is h", |p| p.max_passes))]
    max_passes: Option<u64>,
    /// Number of levels, 1 to 4: settle at 2^(N - 1) times h first, then split the edges and settle
    /// again, down to h; with 1, settle only at h [default: 3 on the CPU, 1 on a GPU and for
    /// several materials; printed: 1]
    #[arg(long, value_name = "N", help_heading = METHOD, value_parser = clap::value_parser!(u32).range(1..=4))]
    pub(crate) levels: Option<u32>,
    /// Maximum number of passes on each level except the last
    #[arg(long, value_name = "N", default_value_t = Parameters::default().coarse_passes, help_heading = METHOD,
        value_parser = clap::value_parser!(u64).range(1..))]
    coarse_passes: u64,
    #[arg(long, value_name = "SHARE", value_parser = share, help_heading = METHOD, alias = "fault-tolerance",
        help = told("Stop when the number of lattice defects (particles without exactly six neighbours) decreases by less than this \
            fraction per pass and density control is nearly at rest, 0 to 1", |p| p.energy_tolerance.map_or(p.defect_tolerance.to_string(), |_| "none".to_owned())))]
    defect_tolerance: Option<f64>,
    #[arg(long, value_name = "SHARE", value_parser = share, help_heading = METHOD, conflicts_with = "defect_tolerance",
        help = told("Use the paper's stop test (E_min) instead: stop when the mean energy changes by less than this fraction per pass, \
            0 to 1; 0 runs all passes", |p| p.energy_tolerance.map_or("none".to_owned(), |e| e.to_string())))]
    energy_tolerance: Option<f64>,
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..), help_heading = METHOD,
        help = told("Number of passes over which the paper's stop test averages this change; 1 compares consecutive passes", |p| p.energy_window))]
    energy_window: Option<u16>,
    #[arg(long, value_name = "SHARE", value_parser = share, help_heading = METHOD,
        help = told("Apply the stop tests only when density control adds and deletes at most this fraction of the particles per pass, \
            0 to 1; with 1, they always apply", |p| p.rest_share))]
    rest_share: Option<f64>,
    #[arg(long, value_name = "N", help_heading = METHOD,
        help = told(&format!("Number of passes without density control at the end, in which the last added particles settle; at most {COARSE_CLOSING_PASSES} on levels before the last"),
            |p| p.closing_passes))]
    closing_passes: Option<u64>,
    #[arg(long, value_name = "E", value_parser = positive, help_heading = METHOD,
        help = told("Target energy of a particle for density control, 0.554 to 7.84. The default is the energy (Eq. 1) in a hexagonal lattice \
            with edge h; other values give a lattice with a different edge, and added particles are placed accordingly", |p| (1e4 * p.ideal_energy).round() / 1e4))]
    ideal_energy: Option<f64>,
    #[arg(long, value_name = "SHARE", value_parser = share, help_heading = METHOD,
        help = told("Add a particle where the energy is below this fraction of the ideal energy, 0 to 1", |p| p.add_below))]
    add_below: Option<f64>,
    #[arg(long, value_name = "RATIO", value_parser = above_one, help_heading = METHOD,
        help = told("Delete a particle whose energy exceeds this multiple of the ideal energy, above 1", |p| p.delete_above))]
    delete_above: Option<f64>,
    /// Never add particles, and use a single level (as in the paper's synthetic test, Table 3)
    #[arg(long, help_heading = METHOD)]
    no_insert: bool,
    #[command(flatten)]
    common: CommonArgs,
}

/// Returns the help text of an option, with its default and its value in the paper.
fn told<T: Display>(text: &str, value: impl Fn(&Parameters) -> T) -> String {
    format!("{text} [default: {}; printed: {}]", value(&Parameters::default()), value(&Parameters::as_printed()))
}

/// Returns the command-line name of a value.
fn name(value: impl ValueEnum) -> String {
    value.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// Parses the number of passes between checkpoints, a positive multiple of [`REORDER_INTERVAL`].
fn interval(text: &str) -> std::result::Result<u64, String> {
    match text.parse::<u64>() {
        Ok(n) if n > 0 && n.is_multiple_of(REORDER_INTERVAL) => Ok(n),
        Ok(_) => Err(format!("must be a multiple of {REORDER_INTERVAL}, from {REORDER_INTERVAL}")),
        Err(error) => Err(error.to_string()),
    }
}

impl Args {
    /// Returns the parameters of a run on a GPU or the CPU, for one object or many materials.
    ///
    /// A GPU uses one level by default: a pass over few particles costs nearly as much as a pass
    /// over many, and each change of level costs up to a second on the host. On the heart, the mean
    /// radius ratio before improvement is 0.970 after 0.123 s with one level and 0.962 after 0.127
    /// s with three. On the ribcage, it is 0.972 after 0.193 s and 0.967 after 0.309 s
    /// (docs/developer/performance.md, "Quality for the time"). The default for many materials is
    /// also one level, because the held particles have the spacing h and do not fit coarser levels.
    pub(crate) fn settling(&self, on_gpu: bool, many: bool) -> Parameters {
        let base = if self.as_printed { Parameters::as_printed() } else { Parameters::default() };
        let levels = if on_gpu || many { 1 } else { base.levels };
        // the CPU moves blocks of particles and does not support the printed order by bins
        let order = self.order.unwrap_or(if on_gpu { base.order } else { Order::Classes });
        let binning = if order == Order::Bins { Binning::Uniform } else { base.binning };
        // an explicit defect tolerance disables the printed energy test
        let printed_test = base.energy_tolerance.filter(|_| self.defect_tolerance.is_none());
        Parameters {
            max_passes: self.max_passes.unwrap_or(base.max_passes),
            defect_tolerance: self.defect_tolerance.unwrap_or(base.defect_tolerance),
            energy_tolerance: self.energy_tolerance.or(printed_test),
            energy_window: self.energy_window.map_or(base.energy_window, usize::from),
            rest_share: self.rest_share.unwrap_or(base.rest_share),
            ideal_energy: self.ideal_energy.unwrap_or(base.ideal_energy),
            add_below: self.add_below.unwrap_or(base.add_below),
            delete_above: self.delete_above.unwrap_or(base.delete_above),
            allow_insert: !self.no_insert,
            closing_passes: self.closing_passes.unwrap_or(base.closing_passes),
            seed: self.common.seed,
            levels: self.levels.unwrap_or(levels),
            coarse_passes: self.coarse_passes,
            binning: self.binning.unwrap_or(binning),
            order,
            ..base
        }
    }

    /// Rejects unsupported combinations of options.
    ///
    /// # Errors
    /// If the lattice spacing of the ideal energy is outside the range that neighbour lists and
    /// steps support, or if the order by bins is requested without a GPU or with graded bins.
    pub(crate) fn check(&self, parameters: &Parameters, on_gpu: bool) -> Result<()> {
        let energy = parameters.ideal_energy;
        let [least, largest] = [LARGEST_SPACING, LEAST_SPACING].map(lattice_energy);
        if !(least..=largest).contains(&energy) {
            return Err(Error::input(
                format!("--ideal-energy {energy}: must be from {least:.3} to {largest:.2}"),
                format!(
                    "neighbour lists and steps support lattice spacings from {LEAST_SPACING} to {LARGEST_SPACING:.3} h"
                ),
                "change --ideal-energy; to change the distance between particles, change h (sizefield)",
            ));
        }
        if parameters.order == Order::Classes {
            return Ok(());
        }
        if parameters.binning == Binning::Graded {
            return Err(Error::input(
                "--binning graded: not supported with --order bins",
                "with bins of several sizes, two bins that are processed together could have a common neighbour",
                "leave out --binning, or set --order classes",
            ));
        }
        if on_gpu {
            return Ok(());
        }
        let (what, why) =
            ("--order bins: not supported on the CPU, and no GPU is used", "the CPU moves blocks of particles instead");
        let next = "set --backend gpu (with --adapter NAME for a software adapter), or leave out --order";
        Err(if self.backend == Backend::Cpu { Error::input(what, why, next) } else { Error::gpu(what, why, next) })
    }
}

impl StageArgs for Args {
    fn common(&self) -> &CommonArgs {
        &self.common
    }

    fn outputs(&self) -> Vec<PathBuf> {
        let mut outputs: Vec<PathBuf> = self.output.clone().into_iter().collect();
        // a resumed run may replace its own log and checkpoint without --force
        if !self.resume {
            outputs.extend(self.log.clone());
            outputs.extend(self.checkpoint.clone());
        }
        outputs
    }

    fn parameters(&self) -> Value {
        // the default number of levels and order depend on the backend, which is not known yet
        json!(self.settling(self.backend == Backend::Gpu, false))
    }

    fn check_options(&self, known: Known) -> Result<Known> {
        let many = known.is_many() == Some(true);
        if many {
            check_levels(self.levels)?;
        }
        // `auto` may select a GPU, which supports more combinations
        let may_use_gpu = self.backend != Backend::Cpu;
        self.check(&self.settling(may_use_gpu, many), may_use_gpu)?;
        Ok(known)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::energy::{PRINTED_IDEAL_ENERGY, ideal_energy, lattice_spacing};
    use isoparticles_stage::error::Kind;

    /// Parses a command line with these options after the file arguments.
    fn given(options: &str) -> Args {
        let files = "particles s.bin --distfield f.vti --sizefield h.vti -o p.bin";
        Args::try_parse_from(format!("{files} {options}").split_whitespace()).expect(options)
    }

    #[test]
    fn what_is_not_given_is_by_default_or_as_printed() {
        let on_gpu = |options: &str| given(options).settling(true, false);
        let on_cpu = |options: &str| given(options).settling(false, false);
        let seed = given("").common.seed;
        assert_eq!(on_cpu(""), Parameters { seed, ..Parameters::default() });
        assert_eq!(on_gpu(""), Parameters { seed, levels: 1, ..Parameters::default() });
        assert_eq!(given("").settling(false, true).levels, 1, "of many materials");
        let printed = Parameters { seed, ..Parameters::as_printed() };
        assert_eq!(on_gpu("--as-printed"), printed);
        assert_eq!(on_cpu("--as-printed"), Parameters { order: Order::Classes, ..printed });
        assert_eq!((printed.levels, printed.closing_passes, printed.ideal_energy), (1, 0, PRINTED_IDEAL_ENERGY));
    }

    #[test]
    fn printed_values_are_options_and_given_options_override_them() {
        let seed = given("").common.seed;
        let parts = "--max-passes 50 --energy-tolerance 0.0015 --energy-window 1 --rest-share 1 --closing-passes 0 --ideal-energy 3.462 \
            --add-below 0.75 --delete-above 1.35 --levels 1 --binning uniform --order bins";
        let printed = Parameters { seed, ..Parameters::as_printed() };
        assert_eq!(given(parts).settling(true, false), printed);
        let others = "--as-printed --max-passes 7 --energy-tolerance 0.5 --energy-window 3 --rest-share 0.1 --closing-passes 2 --ideal-energy 1 \
            --add-below 0.5 --delete-above 2 --levels 2 --binning graded --order classes";
        let wanted = Parameters {
            max_passes: 7,
            energy_tolerance: Some(0.5),
            energy_window: 3,
            rest_share: 0.1,
            closing_passes: 2,
            ideal_energy: 1.0,
            add_below: 0.5,
            delete_above: 2.0,
            levels: 2,
            binning: Binning::Graded,
            order: Order::Classes,
            ..printed
        };
        assert_eq!(given(others).settling(true, false), wanted);
        // an explicit stop test replaces the printed one
        assert_eq!(given("--as-printed --defect-tolerance 0.01").settling(true, false).energy_tolerance, None);
        assert_eq!(given("--order bins").settling(true, false).binning, Binning::Uniform);
    }

    #[test]
    fn what_does_not_go_together_is_refused() {
        let kind = |options: &str, on_gpu: bool| {
            let args = given(options);
            args.check(&args.settling(on_gpu, false), on_gpu).err().map(|error| error.kind)
        };
        assert_eq!(kind("--as-printed --backend cpu", false), None);
        assert_eq!(kind("--as-printed", true), None);
        assert_eq!(kind("--order bins --backend cpu", false), Some(Kind::Input));
        assert_eq!(kind("--order bins", false), Some(Kind::Gpu));
        assert_eq!(kind("--order bins --binning graded", true), Some(Kind::Input));
        assert_eq!(kind("--as-printed --binning graded", true), Some(Kind::Input));
        for (energy, wanted) in [("0.55", Some(Kind::Input)), ("0.56", None), ("7.8", None), ("7.9", Some(Kind::Input))]
        {
            assert_eq!(kind(&format!("--ideal-energy {energy}"), false), wanted, "{energy}");
        }
    }

    #[test]
    fn help_tells_defaults_and_printed_values() {
        let mut command = <Args as clap::CommandFactory>::command();
        let help = command.render_long_help().to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        for told in
            ["[default: 150; printed: 50]", "[default: none; printed: 0.0015]", "[default: classes; printed: bins]"]
        {
            assert!(help.contains(told), "{told} is not in {help}");
        }
        let shown = format!("[default: {:.4}; printed: {PRINTED_IDEAL_ENERGY}]", ideal_energy());
        assert!(help.contains(&shown), "{shown} is not in {help}");
        assert!(help.contains(&format!(
            "of {:.3} h with {:.1} times",
            lattice_spacing(PRINTED_IDEAL_ENERGY),
            lattice_spacing(PRINTED_IDEAL_ENERGY).powi(-2)
        )));
    }
}
