//! Expressions in long videos.

mod files;
mod folder;
mod page;
mod settings;
mod spotted;
mod video;

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_core::Shard;
use srflow_data::micro_expression::intervals::ExpressionKind;

pub use folder::SpottedVideos;
pub(super) use folder::spot_videos;
pub use settings::SpottingArgs;
pub use spotted::{Event, SpottedVideo};

use folder::EVENTS_NAME;
use video::PAGE_ENDING;

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::job_engine::TakenShard;
use crate::output::{write_line, write_page};
use crate::rendering::ShardArgs;
use crate::{Job, Report, Watch, WhenStopped};

/// Spot micro- and macro-expressions in long videos
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow mer spot interview.mp4 --face detect --out spotted
  srflow mer spot long/s01 long/s02 --fps 30 --landmarks long/landmarks.csv --out spotted
  srflow mer spot-score spotted/events.csv --truth long/events.csv

The folder has events.csv (all events, with seconds, region and strength), megc.csv (the challenges' form), and for each \
video NAME.html (the video beside the motion of the face), NAME.frames.csv (the motion of 16 regions) and NAME.eaf (for ELAN). With --face detect the crop follows the face. Running the same command again continues with the videos that are missing. With --shard, several processes or machines do parts of the videos in one shared folder; run the command without it when they are done, which writes events.csv and megc.csv.")]
pub struct SpotJob {
    /// Videos, or folders of frames
    #[arg(required = true, value_name = "VIDEO|FRAMES")]
    pub videos: Vec<PathBuf>,
    /// Folder of the results
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Start over where the folder has results of other settings
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub shard: ShardArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub spotting: SpottingArgs,
}

impl Job for SpotJob {
    const NAME: &'static str = "mer spot";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = SpotReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<SpotReport> {
        let TakenShard { shard, .. } = self.shard.taken()?;
        if self.force && shard != Shard::WHOLE {
            wrong_settings!(
                "`force` starts over, and `shard` does a part: delete {} first",
                self.out.display()
            );
        }
        let SpottedVideos { method, videos, stopped } =
            spot_videos(&self.spotting, &self.videos, &self.out, self.force, shard, watch)?;
        Ok(SpotReport { out: self.out.clone(), shard, method, videos, stopped })
    }
}

/// The result of spotting.
#[derive(Debug, Clone, Serialize)]
pub struct SpotReport {
    #[serde(skip)]
    out: PathBuf,
    #[serde(skip)]
    shard: Shard,
    pub method: String,
    pub videos: Vec<SpottedVideo>,
    #[serde(skip)]
    stopped: bool,
}

impl Report for SpotReport {
    fn stopped(&self) -> bool {
        self.stopped
    }
}

impl fmt::Display for SpotReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for SpottedVideo { video, seconds, events, .. } in &self.videos {
            let micro = events.iter().filter(|event| event.kind == ExpressionKind::Micro).count();
            write_line(
                f,
                format_args!(
                    "{video}: {micro} micro- and {} macro-expressions in {seconds:.1} s",
                    events.len() - micro
                ),
            )?;
        }
        if self.stopped {
            return Ok(());
        }
        if self.shard != Shard::WHOLE {
            return writeln!(
                f,
                "Part {} is complete: {} videos. When all parts are, the same command without --shard writes the tables.",
                self.shard,
                self.videos.len()
            );
        }
        write_line(f, format_args!("Events: {}", self.out.join(EVENTS_NAME).display()))?;
        let page = self.videos.first().map_or("NAME", |video| video.video.as_str());
        write_page(f, &self.out.join(format!("{page}.{PAGE_ENDING}")))
    }
}
