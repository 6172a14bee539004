//! Datasets packed as WebDataset tars.

use std::cell::Cell;
use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::{Map, json};
use srflow_data::pack_source;
use srflow_pack::{PackEvent, PackReport, PackRequest, PackSettings, pack};

pub use srflow_pack::{PackedFlow, TarSize};

use crate::clap::Args;
use crate::output::{ensure_folder, write_line};
use crate::watch::Progress;
use crate::{Job, Report, Watch, WhenStopped};

/// Pack a dataset into WebDataset tars, with an index and a dataset card, to publish and to stream
#[derive(Args, Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow pack srflow --out packed
  srflow pack srflow --out packed --flow png --shard-size 500MB
  srflow eval --dataset wds:packed --method farneback
  srflow eval --dataset wds:https://HOST/FOLDER --method farneback

Running the same command again continues a stopped run: complete tars are kept. docs/guides/publish.md describes the files, how to \
upload them, and how other programs read them.")]
pub struct PackJob {
    /// Folder of a complete dataset written by `srflow render` or `srflow shapes`
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    /// Folder of the packed dataset
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    #[serde(flatten)]
    pub settings: PackSettings,
    /// Stop after packing N pairs; the same command continues
    #[arg(long, value_name = "N")]
    #[serde(default)]
    pub stop_after: Option<u64>,
    /// Delete the packed dataset in the folder and start over
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

impl Job for PackJob {
    const NAME: &'static str = "pack";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = Packed;

    fn work(&self, watch: &Watch) -> anyhow::Result<Packed> {
        ensure_folder(&self.out)?;
        let (done, total, all_bytes) = (Cell::new(0), Cell::new(0), Cell::new(0.0));
        let on_event = |event| {
            let (message, bytes) = match event {
                PackEvent::Found { pairs } => (format!("{pairs} found"), 0),
                PackEvent::Started { pairs, whole, bytes } => {
                    all_bytes.set(bytes as f64 / 1e9);
                    total.set(pairs);
                    done.set(whole);
                    (String::new(), 0)
                }
                PackEvent::Packed { bytes } => {
                    done.set(done.get() + 1);
                    (format!("{:.2} GB of about {:.2} GB", bytes as f64 / 1e9, all_bytes.get()), bytes)
                }
            };
            (watch.on_progress)(&Progress {
                done: done.get(),
                total: Some(total.get()),
                unit: "pairs".into(),
                message,
                facts: Map::from_iter([("bytes".to_owned(), json!(bytes))]),
            });
        };
        let source = pack_source(&self.dir)?;
        let request = PackRequest {
            out: &self.out,
            force: self.force,
            stop_after: self.stop_after,
            stop: watch.stop,
            on_event: &on_event,
        };
        let report = pack(&source, self.settings, &request)?;
        Ok(Packed { packed_dataset: self.out.clone(), report })
    }
}

/// What a run of [`PackJob`] has packed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Packed {
    pub packed_dataset: PathBuf,
    #[serde(flatten)]
    pub report: PackReport,
}

impl Report for Packed {
    fn stopped(&self) -> bool {
        self.report.stopped
    }
}

impl fmt::Display for Packed {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let PackReport { pairs, packed, tars, bytes, stopped, flow_error } = self.report;
        let gigabytes = bytes as f64 / 1e9;
        writeln!(
            f,
            "{packed} of {pairs} pairs packed; {tars} tars, {gigabytes:.3} GB, flow within {flow_error:.2e} px"
        )?;
        if stopped {
            Ok(())
        } else {
            write_line(f, format_args!("read it with wds:{}", self.packed_dataset.display()))
        }
    }
}
