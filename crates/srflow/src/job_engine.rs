//! Which part of a job an engine such as Slurm or Kubernetes has given to this process.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;
use srflow_core::{Shard, excerpt};

/// The value of `--shard`: a part, or `auto` for the one that a job engine has given to this process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ShardChoice {
    /// `I/N`.
    Given(Shard),
    /// `auto`, or `auto/N` with the number of parts, which some engines do not tell.
    Auto(Option<u32>),
}

impl Default for ShardChoice {
    fn default() -> Self {
        Self::Given(Shard::WHOLE)
    }
}

impl fmt::Display for ShardChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Given(shard) => shard.fmt(f),
            Self::Auto(None) => f.write_str("auto"),
            Self::Auto(Some(of)) => write!(f, "auto/{of}"),
        }
    }
}

srflow_core::serialize_as_text!(ShardChoice);

impl FromStr for ShardChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{}`: expected I/N with I from 1 to N, auto, or auto/N", excerpt(text));
        match text.strip_prefix("auto") {
            None => text.parse().map(Self::Given).map_err(|_| wrong()),
            Some("") => Ok(Self::Auto(None)),
            Some(rest) => {
                let of = rest.strip_prefix('/').and_then(|of| of.parse().ok()).filter(|of| *of > 0);
                of.map(|of| Self::Auto(Some(of))).ok_or_else(wrong)
            }
        }
    }
}

/// The part of a work that was taken.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TakenShard {
    #[serde(flatten)]
    pub shard: Shard,
    /// The variables of the job engine that say so, as `NAME=VALUE`; empty for a part that was given.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub from: Vec<String>,
}

/// Why `auto` has no answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ShardError {
    /// There is no job engine.
    #[error(
        "--shard auto: expected the variables of a job engine ({}), found none; give --shard I/N",
        known_engines()
    )]
    NoEngine,
    /// Several engines disagree.
    #[error("--shard auto: found the variables of {0}; give --shard I/N, computed from those that count")]
    Ambiguous(String),
    /// The number of parts is not known.
    #[error(
        "--shard auto: {engine} tells the number of this part ({index}) and not how many there are; give --shard auto/N"
    )]
    NoCount { engine: &'static str, index: String },
    /// There are more or fewer parts than given.
    #[error("--shard auto/{given}: {engine} has {found} parts ({variables}); give --shard auto")]
    OtherCount { engine: &'static str, given: u32, found: u64, variables: String },
    /// A variable has no sense.
    #[error("--shard auto: expected {expected}, found {found} ({engine}); give --shard I/N")]
    Wrong { engine: &'static str, expected: String, found: String },
}

/// How an engine numbers what it starts.
struct Engine {
    name: &'static str,
    /// Variable with the number of this one.
    index: &'static str,
    first: First,
    /// Variable with the difference between two numbers.
    step: Option<&'static str>,
    count: Count,
    /// Whether it starts the processes of one job, rather than jobs.
    within_job: bool,
}

enum First {
    Number(u64),
    Variable(&'static str),
}

enum Count {
    Variable(&'static str),
    /// Variable with the last number.
    Last(&'static str),
    /// That, and how many there are: fewer where numbers are left out, as in `--array=1,5,7`.
    LastOf(&'static str, &'static str),
    Unknown,
}

const SLURM_ARRAY: &str = "a job array of Slurm";
const SLURM_STEP: &str = "srun";

const fn counted(name: &'static str, index: &'static str, count: &'static str, within_job: bool) -> Engine {
    Engine { name, index, first: First::Number(0), step: None, count: Count::Variable(count), within_job }
}

const fn uncounted(name: &'static str, index: &'static str, first: u64) -> Engine {
    Engine { name, index, first: First::Number(first), step: None, count: Count::Unknown, within_job: false }
}

static ENGINES: [Engine; 14] = [
    Engine {
        name: SLURM_ARRAY,
        index: "SLURM_ARRAY_TASK_ID",
        first: First::Variable("SLURM_ARRAY_TASK_MIN"),
        step: Some("SLURM_ARRAY_TASK_STEP"),
        count: Count::LastOf("SLURM_ARRAY_TASK_MAX", "SLURM_ARRAY_TASK_COUNT"),
        within_job: false,
    },
    Engine {
        name: "a job array of Grid Engine",
        index: "SGE_TASK_ID",
        first: First::Variable("SGE_TASK_FIRST"),
        step: Some("SGE_TASK_STEPSIZE"),
        count: Count::Last("SGE_TASK_LAST"),
        within_job: false,
    },
    Engine {
        name: "a job array of LSF",
        index: "LSB_JOBINDEX",
        first: First::Number(1),
        step: Some("LSB_JOBINDEX_STEP"),
        count: Count::Last("LSB_JOBINDEX_END"),
        within_job: false,
    },
    uncounted("a job array of PBS", "PBS_ARRAY_INDEX", 1),
    uncounted("a job array of Torque", "PBS_ARRAYID", 1),
    uncounted("an indexed job of Kubernetes", "JOB_COMPLETION_INDEX", 0),
    counted("an array job of AWS Batch", "AWS_BATCH_JOB_ARRAY_INDEX", "AWS_BATCH_JOB_ARRAY_SIZE", false),
    counted("Google Batch", "BATCH_TASK_INDEX", "BATCH_TASK_COUNT", false),
    counted("Cloud Run", "CLOUD_RUN_TASK_INDEX", "CLOUD_RUN_TASK_COUNT", false),
    // SLURM_NTASKS is there in a batch script too, which runs once.
    counted(SLURM_STEP, "SLURM_PROCID", "SLURM_STEP_NUM_TASKS", true),
    counted("mpirun of Open MPI", "OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE", true),
    counted("mpirun of MPICH", "PMI_RANK", "PMI_SIZE", true),
    counted("torchrun", "RANK", "WORLD_SIZE", true),
    counted("SkyPilot", "SKYPILOT_NODE_RANK", "SKYPILOT_NUM_NODES", true),
];

fn known_engines() -> String {
    let names: Vec<&str> = ENGINES.iter().map(|engine| engine.name).collect();
    names.join(", ")
}

impl ShardChoice {
    /// The part to do; `variable` looks a variable of the environment up.
    ///
    /// Engines are recognised by their variables: job arrays of Slurm, Grid Engine, LSF, PBS and Torque, indexed jobs of Kubernetes, AWS and
    /// Google Batch, Cloud Run, and processes that `srun`, `mpirun`, `torchrun` or SkyPilot started. The processes of a step of a Slurm array
    /// divide the part of their array task.
    ///
    /// # Errors
    /// With `auto`, where there is no engine, several disagree, or the number of parts is not known.
    pub fn taken(self, variable: &dyn Fn(&str) -> Option<String>) -> Result<TakenShard, ShardError> {
        let given = match self {
            Self::Given(shard) => return Ok(TakenShard { shard, from: Vec::new() }),
            Self::Auto(given) => given,
        };
        let mut found: Vec<Place> = Vec::new();
        for engine in &ENGINES {
            found.extend(engine.place(variable, given)?);
        }
        // One process is no division, and launchers that follow each other tell the same.
        found.retain(|place| !(place.engine.within_job && place.count == 1));
        let mut places: Vec<Place> = Vec::new();
        for place in found {
            let same = |other: &Place| {
                let both = place.engine.within_job && other.engine.within_job;
                both && (place.index, place.count) == (other.index, other.count)
            };
            if !places.iter().any(same) {
                places.push(place);
            }
        }
        let (index, count) = match places.as_slice() {
            [] => return Err(ShardError::NoEngine),
            [place] => (place.index, place.count),
            [array, step] if array.engine.name == SLURM_ARRAY && step.engine.name == SLURM_STEP => (
                array.index.saturating_mul(step.count).saturating_add(step.index),
                array.count.saturating_mul(step.count),
            ),
            several => {
                let names: Vec<&str> = several.iter().map(|place| place.engine.name).collect();
                return Err(ShardError::Ambiguous(names.join(" and of ")));
            }
        };
        let from: Vec<String> = places.iter().flat_map(|place| place.from.clone()).collect();
        let engine = places[0].engine.name;
        match given {
            Some(given) if u64::from(given) != count => {
                Err(ShardError::OtherCount { engine, given, found: count, variables: from.join(", ") })
            }
            _ => {
                let wrong = || ShardError::Wrong {
                    engine,
                    expected: format!("at most {} parts", u32::MAX),
                    found: count.to_string(),
                };
                let of = u32::try_from(count).map_err(|_| wrong())?;
                Ok(TakenShard { shard: Shard { number: index as u32 + 1, of }, from })
            }
        }
    }
}

/// The place of this process among those of an engine.
struct Place {
    engine: &'static Engine,
    /// From 0, below `count`.
    index: u64,
    count: u64,
    /// As `NAME=VALUE`.
    from: Vec<String>,
}

impl Engine {
    /// `None` where the engine has started nothing, or not several.
    fn place(
        &'static self,
        variable: &dyn Fn(&str) -> Option<String>,
        given: Option<u32>,
    ) -> Result<Option<Place>, ShardError> {
        let mut from = Vec::new();
        let mut read = |name: &'static str| -> Result<Option<u64>, ShardError> {
            // Grid Engine says `undefined` where there is no array.
            let Some(text) = variable(name).filter(|text| !text.is_empty() && text != "undefined") else {
                return Ok(None);
            };
            let found = format!("{name}={}", excerpt(&text));
            let wrong = || ShardError::Wrong {
                engine: self.name,
                expected: format!("a number in {name}"),
                found: found.clone(),
            };
            let number = text.parse().map_err(|_| wrong())?;
            from.push(found);
            Ok(Some(number))
        };
        let Some(index) = read(self.index)? else { return Ok(None) };
        let first = match self.first {
            First::Number(first) => Some(first),
            First::Variable(name) => read(name)?,
        };
        let step = match self.step {
            None => 1,
            Some(name) => read(name)?.unwrap_or(1).max(1),
        };
        let (last, listed) = match self.count {
            Count::Last(last) => (read(last)?, None),
            Count::LastOf(last, listed) => (read(last)?, read(listed)?),
            Count::Variable(_) | Count::Unknown => (None, None),
        };
        let count = match self.count {
            Count::Variable(name) => read(name)?,
            Count::Unknown => given.map(u64::from),
            _ => last.zip(first).and_then(|(last, first)| Some(last.checked_sub(first)? / step + 1)),
        };
        // LSF numbers jobs outside of arrays 0.
        if last == Some(0) {
            return Ok(None);
        }
        let (first, count) = match (first, count, &self.count) {
            (Some(first), Some(count), _) => (first, count),
            (_, None, Count::Unknown) => {
                return Err(ShardError::NoCount { engine: self.name, index: from.join(", ") });
            }
            // Another program's variable, or a batch script that is not one of several processes.
            _ => return Ok(None),
        };
        let place = index.checked_sub(first).filter(|beyond| beyond % step == 0).map(|beyond| beyond / step);
        match place.filter(|place| *place < count && listed.is_none_or(|listed| listed == count)) {
            Some(index) => Ok(Some(Place { engine: self, index, count, from })),
            None => Err(ShardError::Wrong {
                engine: self.name,
                expected: format!("{count} numbers from {first} on, {step} apart"),
                found: from.join(", "),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    fn taken(choice: &str, variables: &str) -> Result<TakenShard, ShardError> {
        let pairs = variables.split_whitespace().map(|pair| pair.split_once('=').unwrap());
        let variables: BTreeMap<&str, &str> = pairs.collect();
        let choice: ShardChoice = choice.parse().unwrap();
        choice.taken(&|name| variables.get(name).map(|value| (*value).to_owned()))
    }

    fn part(choice: &str, variables: &str) -> String {
        taken(choice, variables).map_or_else(|error| error.to_string(), |taken| taken.shard.to_string())
    }

    #[test]
    fn each_engine_gives_its_part() {
        let array = "SLURM_ARRAY_TASK_MIN=1 SLURM_ARRAY_TASK_MAX=16 SLURM_ARRAY_TASK_STEP=1 SLURM_ARRAY_TASK_COUNT=16";
        for (choice, variables, expected) in [
            ("auto", format!("SLURM_ARRAY_TASK_ID=3 {array}"), "3/16"),
            ("auto/16", format!("SLURM_ARRAY_TASK_ID=3 {array}"), "3/16"),
            // A batch script of several tasks runs once: it has the whole part of its array task.
            ("auto", format!("SLURM_ARRAY_TASK_ID=16 {array} SLURM_PROCID=0 SLURM_NTASKS=4"), "16/16"),
            // A step divides it.
            ("auto", format!("SLURM_ARRAY_TASK_ID=2 {array} SLURM_PROCID=1 SLURM_STEP_NUM_TASKS=4"), "6/64"),
            ("auto", "SLURM_PROCID=1 SLURM_STEP_NUM_TASKS=4".into(), "2/4"),
            ("auto", "SGE_TASK_ID=7 SGE_TASK_FIRST=1 SGE_TASK_LAST=9 SGE_TASK_STEPSIZE=2".into(), "4/5"),
            ("auto", "LSB_JOBINDEX=2 LSB_JOBINDEX_END=8 LSB_JOBINDEX_STEP=1".into(), "2/8"),
            ("auto/5", "PBS_ARRAY_INDEX=5".into(), "5/5"),
            ("auto/5", "JOB_COMPLETION_INDEX=0".into(), "1/5"),
            ("auto", "AWS_BATCH_JOB_ARRAY_INDEX=9 AWS_BATCH_JOB_ARRAY_SIZE=10".into(), "10/10"),
            ("auto", "BATCH_TASK_INDEX=0 BATCH_TASK_COUNT=3".into(), "1/3"),
            ("auto", "CLOUD_RUN_TASK_INDEX=2 CLOUD_RUN_TASK_COUNT=3".into(), "3/3"),
            ("auto", "RANK=5 WORLD_SIZE=8".into(), "6/8"),
            ("auto", "OMPI_COMM_WORLD_RANK=1 OMPI_COMM_WORLD_SIZE=2 PMI_RANK=1 PMI_SIZE=2".into(), "2/2"),
            ("2/7", "RANK=5 WORLD_SIZE=8".into(), "2/7"),
        ] {
            assert_eq!(part(choice, &variables), expected, "{choice} with {variables}");
        }
    }

    #[test]
    fn the_parts_of_an_array_with_steps_cover_everything() {
        let all = (1..=16).step_by(5).flat_map(|id| {
            (0..3).map(move |process| {
                format!(
                    "SLURM_ARRAY_TASK_ID={id} SLURM_ARRAY_TASK_MIN=1 SLURM_ARRAY_TASK_MAX=16 SLURM_ARRAY_TASK_STEP=5 \
                     SLURM_ARRAY_TASK_COUNT=4 SLURM_PROCID={process} SLURM_STEP_NUM_TASKS=3"
                )
            })
        });
        let units: Vec<u64> =
            all.flat_map(|variables| taken("auto", &variables).unwrap().shard.range(100)).collect();
        assert_eq!(units, (0..100).collect::<Vec<u64>>());
    }

    #[test]
    fn what_cannot_be_known_is_said() {
        let irregular =
            "SLURM_ARRAY_TASK_ID=5 SLURM_ARRAY_TASK_MIN=1 SLURM_ARRAY_TASK_MAX=7 SLURM_ARRAY_TASK_COUNT=3";
        for (choice, variables, expected) in [
            ("auto", "", "found none; give --shard I/N"),
            ("auto", "SGE_TASK_ID=undefined LSB_JOBINDEX=0 LSB_JOBINDEX_END=0 RANK=0", "found none"),
            ("auto", "WORLD_SIZE=1 RANK=0", "found none"),
            ("auto", "JOB_COMPLETION_INDEX=4", "give --shard auto/N"),
            ("auto/4", "JOB_COMPLETION_INDEX=4", "4 numbers from 0 on"),
            ("auto/4", "PBS_ARRAY_INDEX=0", "4 numbers from 1 on"),
            ("auto/4", "RANK=0 WORLD_SIZE=3", "torchrun has 3 parts"),
            ("auto", irregular, "7 numbers from 1 on"),
            ("auto/9", "JOB_COMPLETION_INDEX=1 RANK=0 WORLD_SIZE=2", "Kubernetes and of torchrun"),
            ("auto", "RANK=-1 WORLD_SIZE=2", "a number in RANK, found RANK=-1"),
            ("auto", "RANK=0 WORLD_SIZE=99999999999", "at most 4294967295 parts"),
        ] {
            let found = part(choice, variables);
            assert!(found.contains(expected), "{choice} with {variables}: {found}");
        }
    }

    #[test]
    fn text_forms_round_trip() {
        for text in ["2/3", "auto", "auto/12"] {
            assert_eq!(text.parse::<ShardChoice>().unwrap().to_string(), text);
        }
        for text in ["3/2", "0/2", "1/0", "2", "a/b", "-1/2", "1/2/3", "auto/0", "auto/", "automatic"] {
            assert!(text.parse::<ShardChoice>().unwrap_err().contains(text));
        }
    }
}
