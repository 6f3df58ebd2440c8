//! `perceptile profile --scaling`: the cluster that steps are predicted for.

use clap::Args;
use perceptile::format::write::{self, Existing};
use perceptile::profile::scaling::report::{self, Cluster, Scaling};
use perceptile::profile::scaling::{Network, RankMemory, picture};
use perceptile::solver::Options;

use super::{ProfileArgs, show};
use crate::cli::exit::Failure;

/// A cluster that is not at hand.
#[derive(Debug, Args)]
#[command(next_help_heading = "A cluster to predict steps on")]
pub struct ScalingArgs {
    /// Predict steps on a cluster instead, from costs measured here: of the run's tile, or of three
    /// tiles if nothing is set
    #[arg(long, conflicts_with_all = ["trace", "workers"])]
    pub scaling: bool,

    /// Time that a message takes, however short: ns, us, ms or s
    #[arg(long, value_name = "TIME", default_value = "2us", value_parser = parse_time, requires = "scaling")]
    latency: f64,

    /// Bytes that a rank sends in a second: KB/s, MB/s, GB/s or TB/s
    #[arg(long, value_name = "RATE", default_value = "12.5GB/s", value_parser = parse_rate, requires = "scaling")]
    bandwidth: f64,

    /// Threads of a rank, which is a machine, 1 to 1024
    #[arg(long, value_name = "THREADS", default_value = "16", value_parser = clap::value_parser!(u16).range(1..=1024), requires = "scaling")]
    rank_threads: u16,

    /// Bytes that the caches of a rank hold; only what does not fit goes through memory
    #[arg(long, value_name = "SIZE", default_value = "32MB", value_parser = parse_size, requires = "scaling")]
    rank_cache: f64,

    /// Bytes from and to the memory of a rank in a second, by all its threads
    #[arg(long, value_name = "RATE", default_value = "100GB/s", value_parser = parse_rate, requires = "scaling")]
    memory_bandwidth: f64,

    /// Cores that all ranks share, where they are on one machine: to compare with real runs
    #[arg(long, value_name = "CORES", value_parser = clap::value_parser!(u16).range(1..=4096), requires = "scaling")]
    shared_cores: Option<u16>,

    /// Most ranks, 1 to 65536
    #[arg(long, value_name = "RANKS", default_value = "4096", value_parser = clap::value_parser!(u32).range(1..=65536), requires = "scaling")]
    most_ranks: u32,
}

/// Predicts steps of a run's tile, or of the usual ones.
///
/// # Errors
/// Runs that cannot be, outputs that cannot be written, too little memory.
pub fn run(args: &ProfileArgs, own: Option<Options>, threads: usize) -> Result<(), Failure> {
    write::probe(&args.svg, Existing::from_force(args.force))?;
    let its = &args.scaling;
    let cluster = Cluster {
        network: Network { latency: its.latency, bandwidth: its.bandwidth },
        memory: RankMemory { cache: its.rank_cache, bandwidth: its.memory_bandwidth },
        threads: its.rank_threads.into(),
        ranks: its.most_ranks as usize,
        cores: its.shared_cores.map(Into::into),
    };
    let tiles = own.map_or_else(report::tiles, |own| vec![own]);
    let scaling = Scaling::take(&tiles, cluster, args.execution.simd(), threads, args.measure)?;
    show(args, &scaling, picture::svg)
}

/// Units with what they are worth.
type Units = [(&'static str, f64); 4];

const TIMES: Units = [("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3), ("s", 1.0)];
const SIZES: Units = [("KB", 1e3), ("MB", 1e6), ("GB", 1e9), ("TB", 1e12)];

/// Reads a number with one of some units.
fn parse(text: &str, units: Units, what: &str) -> Result<f64, String> {
    let names = units.map(|(name, _)| name).join(", ");
    let wrong = || format!("`{text}` is not {what}: a number and one of {names}");
    let (name, worth) =
        units.into_iter().find(|(name, _)| text.ends_with(name)).ok_or_else(wrong)?;
    let number: f64 = text[..text.len() - name.len()].trim().parse().map_err(|_| wrong())?;
    let value = number * worth;
    if value.is_finite() && value >= 0.0 { Ok(value) } else { Err(wrong()) }
}

fn parse_time(text: &str) -> Result<f64, String> {
    let seconds = parse(text, TIMES, "a time")?;
    if seconds <= 1.0 { Ok(seconds) } else { Err(format!("{text} is more than 1s")) }
}

fn parse_size(text: &str) -> Result<f64, String> {
    parse(text, SIZES, "a size")
}

fn parse_rate(text: &str) -> Result<f64, String> {
    let what = "a rate, such as 12.5GB/s";
    let bytes = text.strip_suffix("/s").ok_or_else(|| format!("`{text}` is not {what}"))?;
    let rate = parse(bytes, SIZES, what)?;
    // Slower than any network, and what is divided by must not be nothing.
    if rate >= 1e3 { Ok(rate) } else { Err(format!("{text} is less than 1KB/s")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_rates_have_units() {
        assert_eq!(parse_time("2us"), Ok(2.0 * 1e-6));
        assert_eq!(parse_time("0.5 s"), Ok(0.5));
        assert_eq!(parse_size("32MB"), Ok(32e6));
        assert_eq!(parse_rate("12.5GB/s"), Ok(12.5e9));
        for wrong in ["", "us", "2", "-1us", "nanus", "infs", "2s", "1e400s", "3µs"] {
            assert!(parse_time(wrong).is_err(), "{wrong}");
        }
        for wrong in ["", "/s", "12.5GB", "0GB/s", "1e-9KB/s", "1GiB/s", "NaNGB/s"] {
            assert!(parse_rate(wrong).is_err(), "{wrong}");
        }
    }
}
