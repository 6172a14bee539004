//! Ranks that train together give the bits of one process, and end together. They are threads here; processes of MPI are tested with
//! the command.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::{Arc, Barrier, Mutex};

use burn::tensor::Device;
use srflow_files::{RunMode, read_run_log};
use srflow_train::config::Config;
use srflow_train::ranks::{Alone, Communicator};
use srflow_train::training_log::Record;
use srflow_train::{Event, Outcome, TrainError, Training, only_files};

use crate::pairs::make_pairs;

/// A rank that is a thread.
struct Thread {
    rank: usize,
    table: Arc<Table>,
}

/// Where the ranks of a training meet.
struct Table {
    ranks: usize,
    barrier: Barrier,
    /// What each rank gives to each.
    places: Mutex<Vec<Vec<Vec<u8>>>>,
}

impl Thread {
    fn exchange(&self, parts: Vec<Vec<u8>>) -> Vec<Vec<u8>> {
        self.table.places.lock().unwrap()[self.rank] = parts;
        self.table.barrier.wait();
        let mine = self.table.places.lock().unwrap().iter().map(|parts| parts[self.rank].clone()).collect();
        self.table.barrier.wait();
        mine
    }
}

impl Communicator for Thread {
    fn rank(&self) -> usize {
        self.rank
    }

    fn ranks(&self) -> usize {
        self.table.ranks
    }

    fn all_gather(&self, mine: &[u8]) -> Vec<Vec<u8>> {
        self.exchange(vec![mine.to_vec(); self.ranks()])
    }

    fn all_to_all(&self, parts: &[&[u8]]) -> Vec<Vec<u8>> {
        self.exchange(parts.iter().map(|part| part.to_vec()).collect())
    }

    fn abort(&self, _: u8) -> ! {
        panic!("a thread cannot end the others")
    }
}

type Results = Vec<Result<Outcome, TrainError>>;

/// Runs `train` as each of `ranks` ranks.
fn together(
    ranks: usize,
    train: impl Fn(&dyn Communicator) -> Result<Outcome, TrainError> + Sync,
) -> Results {
    let places = Mutex::new(vec![Vec::new(); ranks]);
    let table = Arc::new(Table { ranks, barrier: Barrier::new(ranks), places });
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..ranks)
            .map(|rank| {
                let (table, train) = (table.clone(), &train);
                scope.spawn(move || train(&Thread { rank, table }))
            })
            .collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

/// Batches of three, in epochs of two batches and a rest.
fn config(dir: &Path, architecture: &str, accumulate: usize) -> Config {
    let text = format!(
        "[network]\narchitecture = \"{architecture}\"\n[data]\ntrain = \"folder:{}\"\ncrop = \"64x64\"\n\
         [training]\nsteps = 3\nbatch = 3\niterations = 2\nlearning_rate = 4e-4\naccumulate = {accumulate}\n\
         [checkpoints]\nevery = 2\n",
        dir.display()
    );
    Config::parse(&text, "test").unwrap()
}

fn training<'a>(
    config: &'a Config,
    run: &'a Path,
    mode: RunMode,
    communicator: &'a dyn Communicator,
) -> Training<'a> {
    Training {
        config,
        open_made: &only_files,
        devices: DEVICES.get_or_init(|| vec![Device::flex()]),
        run,
        mode,
        communicator,
    }
}

static DEVICES: std::sync::OnceLock<Vec<Device>> = std::sync::OnceLock::new();

/// The bytes of the weights and the optimizer's state in all checkpoints.
fn checkpoints(run: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for checkpoint in fs::read_dir(run.join("checkpoints")).unwrap() {
        let checkpoint = checkpoint.unwrap().path();
        for name in ["model.safetensors", "optimizer.safetensors"] {
            let key = format!("{}/{name}", checkpoint.file_name().unwrap().display());
            files.insert(key, fs::read(checkpoint.join(name)).unwrap());
        }
    }
    files
}

/// The loss, end-point error and norm of the gradients of each step.
fn steps(run: &Path) -> Vec<(f64, f64, f64)> {
    let log = read_run_log::<Record>(run).unwrap().into_iter();
    log.map(|record| match record {
        Record::Step(step) => (step.loss, step.epe, step.gradient_norm),
        other => panic!("{other:?}"),
    })
    .collect()
}

/// Checks that `ranks` ranks give the bits of `one`, a run of one process.
fn compare(ranks: usize, config: &Config, one: &Path, many: &Path) {
    let outcomes = together(ranks, |communicator| {
        training(config, many, RunMode::New, communicator).until(&|_| false, &mut |event| {
            assert_eq!(communicator.rank(), 0, "{event:?}");
        })
    });
    for outcome in outcomes {
        assert_eq!(outcome.unwrap().progress.step, 3);
    }
    assert!(checkpoints(one) == checkpoints(many), "{} and {}", one.display(), many.display());
    assert_eq!(steps(one), steps(many));
}

#[test]
fn ranks_give_the_bits_of_parts_accumulated_in_one_process() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 8);
    for (architecture, ranks) in [("raft-small", 2), ("raft-small", 3), ("skflow", 3)] {
        let [one, many] =
            ["one", "many"].map(|what| dir.path().join(format!("{architecture}-{ranks}-{what}")));
        let frozen = |accumulate| {
            let config = config(dir.path(), architecture, accumulate);
            config.with_override("network.batch_norm=frozen").unwrap()
        };
        training(&frozen(ranks), &one, RunMode::New, &Alone).until(&|_| false, &mut |_| {}).unwrap();
        compare(ranks, &frozen(1), &one, &many);
    }
}

#[test]
fn ranks_give_the_bits_of_devices_with_live_batch_norm() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 8);
    let config = config(dir.path(), "skflow", 1);
    let [one, many] = ["one", "many"].map(|what| dir.path().join(what));
    let devices = vec![Device::flex(); 3];
    let of_devices = Training { devices: &devices, ..training(&config, &one, RunMode::New, &Alone) };
    of_devices.until(&|_| false, &mut |_| {}).unwrap();
    compare(3, &config, &one, &many);
}

#[test]
fn ranks_that_are_stopped_go_on_with_any_number_and_say_so() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 5);
    let config = config(dir.path(), "raft-small", 1);
    let [through, stopped] = ["through", "stopped"].map(|name| dir.path().join(name));
    for outcome in together(2, |communicator| {
        training(&config, &through, RunMode::New, communicator).until(&|_| false, &mut |_| {})
    }) {
        assert!(!outcome.unwrap().stopped);
    }
    // One rank alone gets the signal.
    for outcome in together(2, |communicator| {
        let stop = |done| communicator.rank() == 1 && done >= 1;
        training(&config, &stopped, RunMode::New, communicator).until(&stop, &mut |_| {})
    }) {
        let outcome = outcome.unwrap();
        assert!(outcome.stopped);
        assert_eq!(outcome.progress.step, 1);
    }
    let go_on = |ranks: usize, run: &Path| {
        let before = Mutex::new(Vec::new());
        for outcome in together(ranks, |communicator| {
            training(&config, run, RunMode::Resume, communicator).until(&|_| false, &mut |event| {
                if let Event::Started(start) = event {
                    before.lock().unwrap().push((start.ranks, start.ranks_before, start.done));
                }
            })
        }) {
            assert_eq!(outcome.unwrap().progress.step, 3);
        }
        before.into_inner().unwrap()
    };
    let other = dir.path().join("other");
    copy(&stopped, &other);
    assert_eq!(go_on(2, &stopped), [(2, None, 1)]);
    let last = |run: &Path| fs::read(run.join("last.safetensors")).unwrap();
    assert!(last(&through) == last(&stopped), "as without a stop");
    assert_eq!(go_on(3, &other), [(3, Some(2), 1)]);
    assert!(last(&through) != last(&other), "other sums");
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

#[test]
fn a_rank_that_fails_ends_all() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 6);
    let config = config(dir.path(), "raft-small", 1);
    fs::write(dir.path().join("p4_img2.png"), "no picture").unwrap();
    let run = dir.path().join("run");
    let results = together(3, |communicator| {
        training(&config, &run, RunMode::New, communicator).until(&|_| false, &mut |_| {})
    });
    let own: Vec<usize> = results
        .iter()
        .filter_map(|result| match result.as_ref().expect_err("a pair that cannot be read") {
            error @ TrainError::Rank { rank, ranks: 3, .. } => {
                assert!(error.to_string().contains("p4_img2.png"), "{error}");
                Some(*rank)
            }
            TrainError::OtherRank { reason, .. } => {
                assert!(reason.contains("p4_img2.png"), "{reason}");
                None
            }
            other => panic!("{other}"),
        })
        .collect();
    assert_eq!(own.len(), 1, "one rank says what has happened");

    let too_many = together(4, |communicator| {
        training(&config, &dir.path().join("four"), RunMode::New, communicator).until(&|_| false, &mut |_| {})
    });
    let error = too_many[0].as_ref().expect_err("fewer samples than ranks").to_string();
    assert!(error.contains("training.batch is 3, for 4 ranks"), "{error}");
    assert!(!dir.path().join("four").exists());
}

#[test]
fn ranks_that_differ_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 6);
    let config = config(dir.path(), "raft-small", 1);
    let mut other = config.clone();
    other.training.learning_rate = 1e-3;
    let run = dir.path().join("run");
    let results = together(2, |communicator| {
        let config = if communicator.rank() == 0 { &config } else { &other };
        training(config, &run, RunMode::New, communicator).until(&|_| false, &mut |_| {})
    });
    let error = results[0].as_ref().expect_err("two configurations").to_string();
    assert!(error.contains("the configurations of rank 1 and of rank 0 differ"), "{error}");
    assert!(!run.join("checkpoints").exists());
}
