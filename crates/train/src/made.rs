//! Samples that are made while training.

use rayon::ThreadPool;
use srflow_core::random::Key;
use srflow_core::{Recent, Spares};
use srflow_data::flow::{MadeError, MadePairs, SCENES_AT_ONCE, Sample};

use crate::config::{Config, MadeKind, MadeSpec};
use crate::data_error::DataError;

/// Consecutive pairs that are made at once.
const RUN: u32 = 4;

/// A sample comes up to this many runs later than the first one of its run could, at random.
const LONGEST_DELAY: f32 = 8.0;

/// Runs that are kept: those whose samples have not all come yet, and some more, since threads run ahead of each other.
const KEPT: usize = 2 * LONGEST_DELAY as usize;

/// Opens data that is made while training, with the settings of the configuration.
pub type OpenMade<'a> = dyn Fn(&MadeSpec, &Config) -> Result<Box<dyn MadePairs>, MadeError> + 'a;

/// An [`OpenMade`] for programs that only read files.
///
/// # Errors
/// Always.
pub fn only_files(_: &MadeSpec, _: &Config) -> Result<Box<dyn MadePairs>, MadeError> {
    Err("this program makes no pairs; train on a dataset in files".into())
}

/// Pairs of a [`MadePairs`]: each epoch those of the next `scenes` scenes.
pub(crate) struct Made {
    name: String,
    pairs: Box<dyn MadePairs>,
    /// Of an epoch.
    scenes: u32,
    pairs_of_scene: u32,
    pairs_of_sample: u32,
    runs: Recent<(u32, u32), Vec<Sample>>,
    /// Pools of one thread each, one for each thread of the loader: the work for a pair neither waits for the training's threads nor
    /// takes their turn.
    pools: Spares<ThreadPool>,
}

impl Made {
    pub fn open(spec: &MadeSpec, config: &Config, open: &OpenMade) -> Result<Self, DataError> {
        let name = spec.to_string();
        let failed = |source| DataError::Made { data: name.clone(), source };
        let pairs = open(spec, config).map_err(failed)?;
        let scenes = match spec.kind {
            MadeKind::Shapes => config.data.shapes.pairs,
            MadeKind::Rendered => config.data.rendered.scenes,
        };
        Ok(Self {
            scenes,
            pairs_of_scene: pairs.pairs_per_scene(),
            // A checked configuration has short clips.
            pairs_of_sample: config.training.pairs() as u32,
            pairs,
            runs: Recent::new(KEPT),
            pools: Spares::default(),
            name,
        })
    }

    /// As in `data.train`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Samples of an epoch.
    pub fn samples(&self) -> usize {
        self.scenes as usize * self.samples_of_scene() as usize
    }

    /// One starts at each pair with enough pairs from there on.
    fn samples_of_scene(&self) -> u32 {
        (self.pairs_of_scene + 1).saturating_sub(self.pairs_of_sample)
    }

    /// The samples of an epoch in the order in which they come, each of them `times`. Scenes follow each other such that about
    /// [`SCENES_AT_ONCE`] are in use, and samples of a run come at about the same time: neither needs to be kept for long.
    pub fn order(&self, times: usize, key: Key) -> Vec<usize> {
        let (of_scene, scenes_at_once) = (self.samples_of_scene(), u64::from(SCENES_AT_ONCE));
        let mut delay = key.stream("order of made samples");
        let mut places = Vec::with_capacity(self.samples() * times);
        for scene in 0..self.scenes {
            for first in 0..of_scene {
                let (scene, runs) = (u64::from(scene), u64::from(of_scene.div_ceil(RUN)));
                let begins = scene * runs + u64::from(first / RUN) * scenes_at_once;
                let number = scene as usize * of_scene as usize + first as usize;
                let comes = |_| (begins as f64 + f64::from(delay.uniform(0.0, LONGEST_DELAY)), number);
                places.extend((0..times).map(comes));
            }
        }
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        places.into_iter().map(|(_, number)| number).collect()
    }

    /// The pairs of sample `number` of an epoch, with their names.
    pub fn sample(&self, epoch: u64, number: usize) -> Result<Vec<(String, Sample)>, DataError> {
        let of_scene = self.samples_of_scene() as usize;
        // Repeats itself after 2^32 scenes.
        let scene =
            epoch.wrapping_mul(u64::from(self.scenes)).wrapping_add((number / of_scene) as u64) as u32;
        let first = (number % of_scene) as u32;
        (first..first + self.pairs_of_sample)
            .map(|pair| {
                let name = format!("{} {}", self.name, self.pairs.name(scene, pair));
                let run = self.runs.get((scene, pair / RUN), || self.make(scene, pair / RUN));
                let run = run.map_err(|source| DataError::Made { data: name.clone(), source })?;
                Ok((name, run[(pair % RUN) as usize].clone()))
            })
            .collect()
    }

    fn make(&self, scene: u32, run: u32) -> Result<Vec<Sample>, MadeError> {
        let pool = match self.pools.take() {
            Some(pool) => pool,
            None => rayon::ThreadPoolBuilder::new().num_threads(1).build()?,
        };
        let pairs = run * RUN..self.pairs_of_scene.min((run + 1) * RUN);
        let made = pool.install(|| self.pairs.make(scene, pairs));
        self.pools.put(pool);
        made
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::ops::Range;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use srflow_core::{FlowField, Image};

    use super::*;
    use crate::batch::Batch;
    use crate::training_set::TrainingSet;

    /// Pairs whose pixels are their numbers.
    struct Numbered {
        pairs_per_scene: u32,
        runs_made: Arc<AtomicUsize>,
    }

    impl MadePairs for Numbered {
        fn pairs_per_scene(&self) -> u32 {
            self.pairs_per_scene
        }

        fn name(&self, scene: u32, pair: u32) -> String {
            format!("{scene}/{pair}")
        }

        fn make(&self, scene: u32, run: Range<u32>) -> Result<Vec<Sample>, MadeError> {
            self.runs_made.fetch_add(1, Ordering::SeqCst);
            assert_eq!(rayon::current_num_threads(), 1);
            let frame = |pair: u32| Image::filled(16, 16, [scene as u8, pair as u8, 0]);
            let sample = |pair| Sample {
                frame1: frame(pair),
                frame2: frame(pair + 1),
                flow: Some(FlowField::filled(16, 16, [1.0, 2.0])),
                mask: None,
                occlusion: None,
            };
            Ok(run.map(sample).collect())
        }
    }

    fn set(data: &str, keys: &str) -> (TrainingSet, Arc<AtomicUsize>) {
        let text = format!(
            "[network]\narchitecture = \"memflow\"\n[augmentation]\nkind = \"none\"\n\
             [data]\ntrain = {data}\ncrop = \"16x16\"\n{keys}"
        );
        let config = Config::parse(&text, "test").unwrap();
        config.check().unwrap();
        let runs_made = Arc::new(AtomicUsize::new(0));
        let open = |spec: &MadeSpec, config: &Config| -> Result<Box<dyn MadePairs>, MadeError> {
            let pairs_per_scene = match spec.kind {
                MadeKind::Shapes => 1,
                MadeKind::Rendered => config.data.rendered.frames,
            };
            Ok(Box::new(Numbered { pairs_per_scene, runs_made: runs_made.clone() }))
        };
        (TrainingSet::open(&config, &open).unwrap(), runs_made)
    }

    fn names(set: &TrainingSet, steps: Range<u64>) -> Vec<String> {
        let sample = |step| set.sample(step, 0, 1).unwrap().remove(0).name;
        steps.map(sample).collect()
    }

    #[test]
    fn an_epoch_has_every_pair_as_often_as_asked_for_and_the_next_has_new_ones() {
        let keys = "[data.shapes]\npairs = 30\n[data.rendered]\nscenes = 20\nframes = 10\n";
        let (set, runs_made) = set("[\"shapes:\", \"rendered:*3\"]", keys);
        assert_eq!(set.samples(), 30 + 20 * 10 * 3);
        let epochs = [0..630, 630..1260].map(|steps| names(&set, steps));
        for (epoch, names) in (0..).zip(&epochs) {
            let different: BTreeSet<_> = names.iter().collect();
            assert_eq!(different.len(), 30 + 200);
            for name in different {
                let (kind, number) = name.split_once(' ').unwrap();
                let scene: usize = number.split('/').next().unwrap().parse().unwrap();
                let (scenes, times) = if kind == "shapes:" { (30, 1) } else { (20, 3) };
                assert_eq!(scene / scenes, epoch, "{name}");
                assert_eq!(names.iter().filter(|other| *other == name).count(), times, "{name}");
            }
        }
        // Each run once, although its samples are spread: three runs for a scene of ten pairs.
        assert_eq!(runs_made.load(Ordering::SeqCst), 2 * (30 + 20 * 3));
        // Consecutive samples are of different scenes.
        let changes = epochs[0].windows(2).filter(|two| two[0].split('/').next() != two[1].split('/').next());
        assert!(changes.count() > 400);
    }

    #[test]
    fn scenes_are_used_within_a_short_time() {
        let (set, _) = set("\"rendered:\"", "[data.rendered]\nscenes = 40\nframes = 48\n");
        let names = names(&set, 0..40 * 48);
        let scene = |name: &String| name.split_once(' ').unwrap().1.split('/').next().unwrap().to_owned();
        let scenes: Vec<String> = names.iter().map(scene).collect();
        for at in (0..names.len()).step_by(50) {
            let (before, after): (BTreeSet<_>, BTreeSet<_>) =
                (scenes[..at].iter().collect(), scenes[at..].iter().collect());
            let open = before.intersection(&after).count();
            assert!(open <= SCENES_AT_ONCE as usize + 3, "{open} at {at}");
        }
    }

    #[test]
    fn samples_are_the_same_on_any_number_of_threads_and_after_a_restart() {
        let keys = "[data.rendered]\nscenes = 5\nframes = 6\n";
        let batch = |set: &TrainingSet, step| Batch::new(&set.sample(step, 1, 2).unwrap());
        let (one, _) = set("\"rendered:*2\"", keys);
        let alone: Vec<Batch> = (0..30).map(|step| batch(&one, step)).collect();
        let (again, _) = set("\"rendered:*2\"", keys);
        assert!((17..30).all(|step| batch(&again, step) == alone[step as usize]));
        let (shared, _) = set("\"rendered:*2\"", keys);
        std::thread::scope(|scope| {
            for first in 0..3 {
                let (shared, alone) = (&shared, &alone);
                scope.spawn(move || {
                    for step in (first..30).step_by(3) {
                        assert!(batch(shared, step) == alone[step as usize], "step {step}");
                    }
                });
            }
        });
    }

    #[test]
    fn clips_go_on_from_run_to_run() {
        let keys = "[data.rendered]\nscenes = 2\nframes = 9\n[training]\nclip_frames = 4\n";
        let (set, _) = set("\"rendered:\"", keys);
        assert_eq!(set.samples(), 2 * 7);
        for step in 0..14 {
            let clip = set.sample(step, 0, 1).unwrap();
            assert_eq!(clip.len(), 3);
            assert!(clip.windows(2).all(|two| two[0].sample.frame2 == two[1].sample.frame1));
        }
    }
}
