use std::cell::Cell;
use std::path::PathBuf;

use clap::Args;
use serde_json::json;
use srflow_read::packed::{PackError, PackEvent, PackReport, PackRequest, PackSettings, PackedFlow, pack};

use crate::Context;
use crate::interrupt::{self, Continuable};
use crate::output::ensure_folder;
use crate::progress::{Lines, bar};
use crate::rendering::exit_if_stopped;
use crate::usage::wrong_usage;

/// Pack a dataset into WebDataset tars, with an index and a dataset card, to publish and to stream
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow pack srflow --out packed
  srflow pack srflow --out packed --flow png --shard-size 500MB
  srflow eval --dataset wds:packed --method farneback
  srflow eval --dataset wds:https://HOST/FOLDER --method farneback

The same command given again continues where a run was stopped: whole tars are kept. docs/guides/publish.md describes the files, how to
upload them, and how other programs read them.")]
pub struct Pack {
    /// Folder of a complete dataset written by `srflow render` or `srflow shapes`
    #[arg(value_name = "DIR")]
    dir: PathBuf,
    /// Folder of the packed dataset
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Flow: npy (float16), npy32 (float32), png (KITTI's 16-bit PNG) or npz16 (as `srflow render` writes it)
    #[arg(long, value_name = "FORMAT", default_value_t = PackSettings::default().flow)]
    flow: PackedFlow,
    /// Size of a tar, about: bytes, or with kB, MB or GB
    #[arg(long, value_name = "SIZE", default_value = "1GB", value_parser = bytes)]
    shard_size: u64,
    /// Stop after packing N pairs, with exit code 75; the same command continues
    #[arg(long, value_name = "N")]
    stop_after: Option<u64>,
    /// Delete the packed dataset in the folder and start over
    #[arg(long)]
    force: bool,
}

/// A size in bytes, with or without a decimal unit.
fn bytes(text: &str) -> Result<u64, String> {
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let unit = match unit.trim() {
        "" | "B" => Some(1),
        "kB" | "KB" => Some(1000),
        "MB" => Some(1_000_000),
        "GB" => Some(1_000_000_000),
        _ => None,
    };
    let size = number.parse::<u64>().ok().zip(unit).and_then(|(number, unit)| number.checked_mul(unit));
    size.ok_or_else(|| format!("expected a size such as 500MB or 1GB, found `{text}`"))
}

pub fn run(args: Pack, context: &Context) -> anyhow::Result<()> {
    ensure_folder(&args.out)?;
    let bar = bar(0, "{wide_bar} {pos}/{len} pairs, {msg}, {eta} left");
    let settings = PackSettings { flow: args.flow, shard_size: args.shard_size };
    let total = Cell::new(0.0);
    let lines = Lines::new();
    let on_event = |event| {
        match event {
            PackEvent::Found { pairs } => bar.set_message(format!("{pairs} found")),
            PackEvent::Started { pairs, whole, bytes } => {
                total.set(bytes as f64 / 1e9);
                bar.set_length(pairs);
                bar.set_position(whole);
                bar.reset_eta();
                bar.reset_elapsed();
            }
            PackEvent::Packed { bytes } => {
                bar.inc(1);
                bar.set_message(format!("{:.2} GB of about {:.2} GB", bytes as f64 / 1e9, total.get()));
            }
        }
        lines.now_and_then(&bar, "pairs");
    };
    let request = PackRequest {
        dir: &args.dir,
        out: &args.out,
        force: args.force,
        stop_after: args.stop_after,
        stop: &interrupt::requested,
        on_event: &on_event,
    };
    let continuable = Continuable::counted(&bar, "pairs");
    let report = pack(settings, &request);
    drop(continuable);
    bar.finish_and_clear();
    let report = match report {
        Err(error @ PackError::Argument { .. }) => wrong_usage!("{error}"),
        report => report?,
    };
    let PackReport { pairs, packed, tars, bytes, stopped, flow_error } = report;
    if context.json {
        crate::output::print_json(&json!({
            "packed_dataset": args.out,
            "pairs": pairs,
            "packed": packed,
            "tars": tars,
            "bytes": bytes,
            "stopped": stopped,
            "flow_error": flow_error,
        }))?;
    } else {
        let gigabytes = bytes as f64 / 1e9;
        say!(
            "{packed} of {pairs} pairs packed; {tars} tars, {gigabytes:.3} GB, flow within {flow_error:.2e} px"
        )?;
        if !stopped {
            say!("read it with wds:{}", args.out.display())?;
        }
    }
    exit_if_stopped(stopped)
}
