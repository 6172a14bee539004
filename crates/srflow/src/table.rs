//! The table of jobs, for front ends that treat all alike, such as Python.

use serde_json::{Map, Value};

use crate::settings::from_json;
use crate::{
    Error, FollowUp, Job, Report, Watch, ablation, avatar, check, convert, demo, device, eval, face, figure,
    flow, mer, merge, metrics, models, pack, rasterize, render, shapes, train, view,
};

/// A job that is known by its name.
pub struct Entry {
    /// The words of its command, e.g. `mer run`.
    pub name: &'static str,
    /// Runs it with settings as JSON; others have their defaults.
    run: fn(Map<String, Value>, &Watch) -> Result<Done, Error>,
    /// Its settings as the options of a command.
    #[cfg(feature = "clap")]
    pub command: fn() -> ::clap::Command,
}

/// The report of a job of the table.
pub struct Done {
    /// As the command prints it with `--json`.
    pub report: Value,
    /// As the command prints it.
    pub text: String,
    /// What the job found wrong; see [`Report::failure`].
    pub failure: Option<String>,
    /// See [`Report::follow_up`].
    pub follow_up: Option<FollowUp>,
}

macro_rules! jobs {
    ($($job:ty),+ $(,)?) => {
        /// All jobs.
        pub static JOBS: &[Entry] = &[$(Entry {
            name: <$job as Job>::NAME,
            run: run::<$job>,
            #[cfg(feature = "clap")]
            command: command::<$job>,
        }),+];
    };
}

jobs![
    demo::DemoJob,
    render::RenderJob,
    shapes::ShapesJob,
    flow::FlowJob,
    face::FaceJob,
    metrics::MetricsJob,
    convert::ConvertJob,
    rasterize::RasterizeJob,
    models::ModelsJob,
    models::InspectJob,
    models::ExportJob,
    device::DevicesJob,
    device::TimeNetworkJob,
    device::TimeRasterizerJob,
    train::TrainJob,
    ablation::AblationJob,
    merge::MergeJob,
    pack::PackJob,
    check::CheckJob,
    eval::EvalJob,
    figure::FigureJob,
    view::ViewJob,
    avatar::capture::CaptureJob,
    avatar::import::ImportJob,
    avatar::fit::FitJob,
    avatar::from_video::FromVideoJob,
    avatar::train::TrainJob,
    avatar::eval::EvalJob,
    avatar::mesh::MeshJob,
    avatar::export::ExportJob,
    avatar::units::UnitsJob,
    avatar::landmarks::LandmarksJob,
    mer::data::DataJob,
    mer::synth::SynthJob,
    mer::synth_long::SynthLongJob,
    mer::apex::ApexJob,
    mer::spot::SpotJob,
    mer::predict::PredictJob,
    mer::spot_score::SpotScoreJob,
    mer::strain::StrainJob,
    mer::features::FeaturesJob,
    mer::run::RunJob,
    mer::tables::TablesJob,
];

impl Entry {
    /// The job of this name.
    pub fn named(name: &str) -> Option<&'static Self> {
        JOBS.iter().find(|entry| entry.name == name)
    }

    /// Runs the job.
    ///
    /// # Errors
    /// A setting that is unknown, missing or wrong, by its name; or those of [`Job::run`].
    pub fn run(&self, settings: Map<String, Value>, watch: &Watch) -> Result<Done, Error> {
        (self.run)(settings, watch)
    }
}

fn run<J: Job>(settings: Map<String, Value>, watch: &Watch) -> Result<Done, Error> {
    let mut job: J = from_json(&settings)?;
    if let Some(Value::Object(mut all)) = job.preset_defaults() {
        all.extend(settings);
        job = from_json(&all)?;
    }
    let report = job.run(watch)?;
    // By way of text, where 0.8 stays 0.8: as a value, a float of 32 bits becomes one of 64 with all its digits.
    let json = serde_json::to_string(&report).and_then(|text| serde_json::from_str(&text));
    Ok(Done {
        report: json.map_err(anyhow::Error::from)?,
        text: report.to_string(),
        failure: report.failure(),
        follow_up: report.follow_up(),
    })
}

#[cfg(feature = "clap")]
fn command<J: Job + ::clap::Args>() -> ::clap::Command {
    J::augment_args(::clap::Command::new(J::NAME))
}

#[cfg(all(test, feature = "clap"))]
mod tests {
    use super::*;

    #[test]
    fn every_job_has_a_valid_command_of_its_own_name() {
        for (place, entry) in JOBS.iter().enumerate() {
            (entry.command)().debug_assert();
            assert!(JOBS[..place].iter().all(|other| other.name != entry.name), "{}", entry.name);
        }
    }

    #[test]
    fn unknown_and_wrong_settings_are_named() {
        let refused = |settings: Value| {
            let Value::Object(settings) = settings else { unreachable!("an object is given") };
            Entry::named("render")
                .and_then(|entry| entry.run(settings, &Watch::SILENT).err())
                .map(|e| e.to_string())
        };
        let error = refused(serde_json::json!({ "out": "/nowhere", "scense": 3 })).expect("refused");
        assert!(error.contains("`scense`") && error.contains("scenes"), "{error}");
        let error = refused(serde_json::json!({ "scenes": 3 })).expect("refused");
        assert!(error.contains("out"), "{error}");
        let error = refused(serde_json::json!({ "out": "/nowhere", "size": "12" })).expect("refused");
        assert!(error.contains("WIDTHxHEIGHT"), "{error}");
    }
}
