//! Leave-one-subject-out on made-up features.

use std::path::Path;
use std::sync::Mutex;

use srflow_core::Plane;
use srflow_core::random::Key;
use srflow_data::micro_expression::Classes;
use srflow_mer::{
    Balance, ClassifierEntry, FEATURE_SIDE, Features, Fold, FoldFolder, LabelledClip, LeftOut, Loso,
    LosoError, LosoEvent, LosoWatch, Protocol, Sample, StstNet, Summary, leave_one_subject_out_by, leave_out,
    read_predictions, write_predictions,
};

use crate::made_up::{NEGATIVE, POSITIVE, SURPRISE};

const UNWATCHED: LosoWatch = LosoWatch { on_event: &|_| {}, stop: &|| false };

const STSTNET: ClassifierEntry = ClassifierEntry::of::<StstNet>();

/// Motion by class: down on the left, up on the right, up everywhere; and noise.
fn sample(dataset: &str, subject: u32, clip: u32, class: usize) -> Sample {
    let mut noise = Key::new(9).scene(subject).frame(clip).stream(dataset);
    let mut map = |motion: &dyn Fn(usize) -> f32| {
        Plane::from_fn(FEATURE_SIDE, FEATURE_SIDE, |x, _| motion(x) + 0.3 * noise.normal())
    };
    let u = map(&|_| 0.0);
    let v = map(&|x| match class {
        NEGATIVE if x < FEATURE_SIDE / 2 => 0.5,
        NEGATIVE => 0.0,
        POSITIVE if x < FEATURE_SIDE / 2 => 0.0,
        POSITIVE => -0.5,
        _ => -0.5,
    });
    let strain = map(&|_| 0.1);
    Sample {
        dataset: dataset.into(),
        subject: format!("{subject:02}"),
        clip: format!("clip {clip}"),
        class,
        features: Features::new(&u, &v, &strain).unwrap(),
        head_motion: None,
    }
}

/// `subjects` of each of two datasets, with two clips of each class; one more with a single clip.
fn samples(subjects: u32) -> Vec<Sample> {
    let mut samples = vec![sample("b", 99, 0, NEGATIVE)];
    for dataset in ["a", "b"] {
        for subject in 0..subjects {
            for clip in 0..6 {
                samples.push(sample(dataset, subject, clip, clip as usize % 3));
            }
        }
    }
    samples
}

fn protocol(epochs: usize) -> Protocol {
    Protocol { epochs, record_every: 2, batch: 8, seed: 5, ..Protocol::default() }
}

fn run(
    classifier: ClassifierEntry,
    samples: &[Sample],
    protocol: &Protocol,
    folder: Option<&Path>,
    threads: usize,
) -> (Loso, Vec<LosoEvent>) {
    let events = Mutex::default();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let log = |event| {
        Mutex::lock(&events)
            .map(|mut events: std::sync::MutexGuard<Vec<LosoEvent>>| events.push(event))
            .unwrap()
    };
    let loso = pool
        .install(|| {
            let classes = Classes::default();
            let folder = folder.map(FoldFolder::from);
            leave_out(
                LeftOut::EachSubject,
                &classifier,
                samples,
                classes.names(),
                protocol,
                folder,
                LosoWatch { on_event: &log, stop: &|| false },
            )
        })
        .unwrap();
    (loso, events.into_inner().unwrap())
}

fn epochs(events: &[LosoEvent]) -> usize {
    events.iter().filter(|event| matches!(event, LosoEvent::Epoch { .. })).count()
}

fn folds(events: &[LosoEvent], of_an_earlier_run: bool) -> usize {
    let counts = |event: &&LosoEvent| matches!(event, LosoEvent::Fold { resumed, .. } if *resumed == of_an_earlier_run);
    events.iter().filter(counts).count()
}

#[test]
fn a_classifier_learns_to_separate_the_classes() {
    let protocol = Protocol { learning_rate: 5e-3, ..protocol(16) };
    let (loso, _) = run(STSTNET, &samples(4), &protocol, None, 2);
    assert_eq!(loso.folds.len(), 9);
    assert_eq!(loso.predictions.len(), 49 * protocol.recorded().len());
    let summary = Summary::of(&loso.classes, &loso.predictions).unwrap();
    let accuracy = summary.last().mean.accuracy;
    assert!(accuracy > 0.9, "{accuracy} where always negative has {}", summary.baseline().mean.accuracy);
    assert!(loso.folds.iter().all(|fold| fold.training_losses[0] > *fold.training_losses.last().unwrap()));
}

#[test]
fn the_linear_classifier_learns_at_once_and_refuses_epochs() {
    let (samples, folder) = (samples(3), tempfile::tempdir().unwrap());
    let linear = ClassifierEntry::LINEAR;
    let (loso, events) = run(linear, &samples, &Protocol::default(), Some(folder.path()), 2);
    let summary = Summary::of(&loso.classes, &loso.predictions).unwrap();
    assert!(summary.last().mean.accuracy > 0.95, "{}", summary.last().mean.accuracy);
    assert_eq!((summary.epochs.len(), folds(&events, false), epochs(&events)), (1, 7, 7));
    let (again, events) = run(linear, &samples, &Protocol::default(), Some(folder.path()), 1);
    assert_eq!((again.predictions, folds(&events, true)), (loso.predictions, 7));

    let protocol = Protocol { epochs: 21, ..Protocol::default() };
    let classes = Classes::default();
    let error =
        leave_out(LeftOut::EachSubject, &linear, &samples, classes.names(), &protocol, None, UNWATCHED);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("linear classifier is trained at once and has no use for `epochs`"), "{error}");
    let drawn = Protocol { balance: Balance::Sampling, ..Protocol::default() };
    let error = leave_out(LeftOut::EachSubject, &linear, &samples, classes.names(), &drawn, None, UNWATCHED);
    assert!(error.unwrap_err().to_string().contains("set `balance` to weights"));
    let weights = Protocol { balance: Balance::Weights, ..Protocol::default() };
    let (_, events) = run(linear, &samples, &weights, Some(folder.path()), 1);
    assert_eq!(folds(&events, true), 0, "folds of another training are other folds");
}

/// How far a class is above another in the scores of its clips after the last epoch, on average.
fn margin(loso: &Loso, class: usize, other: usize) -> f64 {
    let last = loso.predictions.iter().map(|prediction| prediction.epoch).max();
    let of_class = loso.predictions.iter().filter(|p| p.truth == class && Some(p.epoch) == last);
    let margins: Vec<f64> = of_class.map(|p| f64::from(p.scores[class] - p.scores[other])).collect();
    margins.iter().sum::<f64>() / margins.len() as f64
}

#[test]
fn balanced_training_scores_a_rare_class_higher() {
    // Two classes that noise nearly hides, eleven clips of one for each of the other.
    let mut samples = Vec::new();
    for (subject, clip) in (0..6).flat_map(|subject| (0..12).map(move |clip| (subject, clip))) {
        let class = if clip == 0 { SURPRISE } else { NEGATIVE };
        let mut noisy = sample("a", subject, clip, class);
        let mut noise = Key::new(4).scene(subject).frame(clip).stream("whole clip");
        let shifts = [0, 1].map(|_| 0.7 * noise.normal());
        let half = |place: usize| place % FEATURE_SIDE * 2 / FEATURE_SIDE;
        let values = noisy.features.values().iter().enumerate();
        let is_v = |place: usize| place / (FEATURE_SIDE * FEATURE_SIDE) == 1;
        let shifted =
            values.map(|(place, value)| if is_v(place) { value + shifts[half(place)] } else { *value });
        noisy.features = Features::from_values(shifted.collect()).unwrap();
        samples.push(noisy);
    }
    let found = |classifier, balance| {
        let of_network = Protocol { learning_rate: 2e-3, ..protocol(10) };
        let protocol = if classifier == STSTNET { of_network } else { Protocol::default() };
        margin(&run(classifier, &samples, &Protocol { balance, ..protocol }, None, 2).0, SURPRISE, NEGATIVE)
    };
    for (classifier, ways) in [
        (ClassifierEntry::LINEAR, &[Balance::Weights][..]),
        (STSTNET, &[Balance::Weights, Balance::Sampling]),
    ] {
        let none = found(classifier, Balance::None);
        for balance in ways {
            let balanced = found(classifier, *balance);
            assert!(balanced > none, "{classifier}, {balance}: {balanced}, {none} without");
        }
    }
}

/// The network that the paper uses, with dropout, batch norms and every kernel that could share its work.
#[test]
fn results_have_the_same_bits_on_any_number_of_threads_and_in_any_order() {
    let mut samples = samples(1);
    let (one, _) = run(ClassifierEntry::OFF_TANET, &samples, &protocol(2), None, 1);
    samples.reverse();
    let (three, _) = run(ClassifierEntry::OFF_TANET, &samples, &protocol(2), None, 3);
    assert_eq!(one.predictions, three.predictions);
    let losses = |loso: &Loso| loso.folds.iter().map(|fold| fold.training_losses.clone()).collect::<Vec<_>>();
    assert_eq!(losses(&one), losses(&three));
    let other = Protocol { seed: 6, ..protocol(2) };
    assert_ne!(run(ClassifierEntry::OFF_TANET, &samples, &other, None, 3).0.predictions, one.predictions);
}

#[test]
fn finished_folds_are_not_run_again() {
    let folder = tempfile::tempdir().unwrap();
    let (samples, protocol) = (samples(2), protocol(3));
    let (whole, events) = run(STSTNET, &samples, &protocol, Some(folder.path()), 2);
    assert_eq!(folds(&events, false), 5);
    assert_eq!(epochs(&events), 15);

    // As a killed run leaves it: two folds are missing, of one there is half a file. In another a digit has changed.
    let mut files: Vec<_> =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert_eq!(files.len(), 5);
    std::fs::remove_file(&files[0]).unwrap();
    std::fs::remove_file(&files[3]).unwrap();
    let text = std::fs::read(&files[1]).unwrap();
    std::fs::write(&files[1], &text[..text.len() / 2]).unwrap();
    let mut text = std::fs::read(&files[2]).unwrap();
    let digit = text.iter().rposition(|byte| *byte == b']').unwrap() - 4;
    assert!(text[digit].is_ascii_digit());
    text[digit] ^= 1;
    std::fs::write(&files[2], &text).unwrap();
    let (resumed, events) = run(STSTNET, &samples, &protocol, Some(folder.path()), 2);
    assert_eq!(folds(&events, true), 1);
    assert_eq!(epochs(&events), 12);
    assert_eq!(resumed.predictions, whole.predictions);

    // Another seed, another network, other features: other folds.
    let other = Protocol { seed: 6, ..protocol.clone() };
    assert_eq!(epochs(&run(STSTNET, &samples, &other, Some(folder.path()), 2).1), 15);
    let mut changed = samples.clone();
    changed[0] = sample("b", 99, 1, NEGATIVE);
    changed[0].clip.clone_from(&samples[0].clip);
    assert_eq!(epochs(&run(STSTNET, &changed, &protocol, Some(folder.path()), 2).1), 15);
}

#[test]
fn each_seed_is_a_run_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let samples = samples(1);
    let several = Protocol { seeds: 2, ..protocol(2) };
    let (both, _) = run(STSTNET, &samples, &several, Some(folder.path()), 2);
    let of_seed =
        |loso: &Loso, seed| loso.predictions.iter().filter(|p| p.seed == seed).cloned().collect::<Vec<_>>();
    for seed in [5, 6] {
        // Each finds its folds where several seeds left them.
        let alone = Protocol { seed, ..protocol(2) };
        let (alone, events) = run(STSTNET, &samples, &alone, Some(folder.path()), 2);
        assert_eq!((folds(&events, true), folds(&events, false)), (3, 0));
        assert_eq!(of_seed(&both, seed), alone.predictions);
    }
    assert_eq!(both.predictions.len(), of_seed(&both, 5).len() + of_seed(&both, 6).len());
    let classes = Classes::default();
    let linear = ClassifierEntry::LINEAR;
    let several = Protocol { seeds: 2, ..Protocol::default() };
    let error =
        leave_out(LeftOut::EachSubject, &linear, &samples, classes.names(), &several, None, UNWATCHED);
    assert!(error.unwrap_err().to_string().contains("has no use for `seeds`"));
}

#[test]
fn a_dataset_is_classified_by_what_the_others_taught() {
    let folder = tempfile::tempdir().unwrap();
    // The other dataset shows the classes the other way round: what it teaches is wrong here.
    let mut samples = samples(3);
    for sample in samples.iter_mut().filter(|sample| sample.dataset == "b") {
        sample.class = match sample.class {
            NEGATIVE => POSITIVE,
            POSITIVE => NEGATIVE,
            surprise => surprise,
        };
    }
    let classes = Classes::default();
    let linear = ClassifierEntry::LINEAR;
    let without = |dataset| {
        let folder = Some(FoldFolder::from(folder.path()));
        let protocol = Protocol::default();
        leave_out(LeftOut::Dataset(dataset), &linear, &samples, classes.names(), &protocol, folder, UNWATCHED)
    };
    let loso = without("a").unwrap();
    assert_eq!((loso.folds.len(), loso.folds[0].name(), loso.folds[0].clips), (1, "a".to_owned(), 18));
    assert!(loso.predictions.iter().all(|prediction| prediction.dataset == "a"));
    for prediction in &loso.predictions {
        assert_eq!(prediction.predicted == prediction.truth, prediction.truth == SURPRISE, "{prediction:?}");
    }
    // Scores are over the subjects of the dataset.
    let outcome = srflow_mer::Outcome::of("made up", "cross-a", &loso).unwrap();
    assert_eq!(outcome.summary.folds.len(), 3);
    let losses: Vec<_> =
        srflow_mer::fold_table(&outcome).rows.iter().map(|row| *row.values.last().unwrap()).collect();
    assert!(losses[0].is_some() && losses.iter().all(|loss| *loss == losses[0]), "{losses:?}");
    assert!(without("b").unwrap().predictions.len() == 19, "the fold of another dataset is another one");
    let error = without("c").unwrap_err().to_string();
    assert!(error.contains("no clip of c"), "{error}");
}

#[test]
fn every_number_follows_from_the_predictions_file() {
    let folder = tempfile::tempdir().unwrap();
    let several = Protocol { seeds: 2, ..protocol(3) };
    let (loso, _) = run(STSTNET, &samples(2), &several, None, 2);
    let summary = Summary::of(&loso.classes, &loso.predictions).unwrap();
    let path = folder.path().join("predictions.csv");
    let trial = srflow_mer::Trial {
        method: "made up".into(),
        set: "composite".into(),
        classes: loso.classes,
        predictions: loso.predictions,
    };
    write_predictions(&path, &[trial]).unwrap();
    let read = read_predictions(&path).unwrap();
    assert_eq!(Summary::of(&read[0].classes, &read[0].predictions).unwrap(), summary);
    for prediction in &read[0].predictions {
        assert_eq!(srflow_mer::Prediction::class_of(&prediction.scores), prediction.predicted);
    }
}

#[test]
fn a_class_that_only_one_subject_shows_is_recorded() {
    let mut samples = samples(1);
    samples.retain(|sample| sample.class != SURPRISE || sample.dataset == "a");
    let (loso, _) = run(STSTNET, &samples, &protocol(1), None, 1);
    let unseen: Vec<_> = loso.folds.iter().map(|fold| fold.unseen_classes.clone()).collect();
    assert_eq!(unseen, [vec!["surprise"], vec![], vec![]]);
}

#[test]
fn any_number_of_classes_goes_from_training_to_tables() {
    // Four classes of three motions: the last two look alike.
    let mut samples = samples(2);
    for sample in samples.iter_mut().filter(|sample| sample.class == SURPRISE) {
        sample.class += usize::from(sample.clip == "clip 5");
    }
    let classes: std::sync::Arc<[String]> = ["sad", "glad", "awed", "struck"].map(str::to_owned).into();
    let loso = leave_out(LeftOut::EachSubject, &STSTNET, &samples, &classes, &protocol(2), None, UNWATCHED);
    let loso = loso.unwrap();
    assert!(loso.predictions.iter().all(|prediction| prediction.scores.len() == 4));
    let trial = srflow_mer::Trial {
        method: "made up".into(),
        set: "a".into(),
        classes: loso.classes.clone(),
        predictions: loso.predictions.clone(),
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("predictions.csv");
    write_predictions(&path, std::slice::from_ref(&trial)).unwrap();
    assert_eq!(read_predictions(&path).unwrap(), [trial]);
    let outcome = srflow_mer::Outcome::of("made up", "a", &loso).unwrap();
    let table = srflow_mer::confusions_csv(std::slice::from_ref(&outcome));
    assert!(table.starts_with(
        "set,method,epoch,truth,predicted_sad,predicted_glad,predicted_awed,predicted_struck\n"
    ));
    assert_eq!(table.lines().count(), 5);
    assert_eq!(outcome.summary.clips(), samples.len());
    assert!(srflow_mer::confusion_latex(&outcome).contains("& sad & glad & awed & struck"));
}

#[test]
fn a_run_that_is_stopped_keeps_its_finished_folds() {
    let folder = tempfile::tempdir().unwrap();
    let (samples, classes) = (samples(2), Classes::default());
    let (whole, _) = run(STSTNET, &samples, &protocol(2), None, 2);
    let finished = std::sync::atomic::AtomicUsize::new(0);
    let on_event = |event| {
        if let LosoEvent::Fold { .. } = event {
            finished.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        }
    };
    let stop = || finished.load(std::sync::atomic::Ordering::Relaxed) >= 2;
    let kept = Some(folder.path());
    let stopped = leave_out(
        LeftOut::EachSubject,
        &STSTNET,
        &samples,
        classes.names(),
        &protocol(2),
        kept.map(FoldFolder::from),
        LosoWatch { on_event: &on_event, stop: &stop },
    );
    assert!(matches!(stopped, Err(LosoError::Stopped)));
    let (resumed, events) = run(STSTNET, &samples, &protocol(2), kept, 2);
    assert!(folds(&events, true) >= 2);
    assert_eq!(resumed.predictions, whole.predictions);
}

#[test]
fn a_classifier_of_another_program_gets_the_same_folds() {
    let (samples, classes) = (samples(2), Classes::default());
    let (ours, _) = run(STSTNET, &samples, &protocol(1), None, 2);
    let clips: Vec<LabelledClip> = samples.iter().map(LabelledClip::from).collect();
    let truth = |fold: &Fold| fold.tested.iter().map(|&index| clips[index].class).collect::<Vec<_>>();
    let by = |classify: &mut dyn FnMut(&Fold) -> Result<Vec<usize>, LosoError>| {
        leave_one_subject_out_by(&clips, classes.names(), classify)
    };
    let loso = by(&mut |fold| {
        assert_eq!(fold.tested.len() + fold.training.len(), samples.len());
        assert!(fold.training.iter().all(|index| !fold.tested.contains(index)));
        Ok(truth(fold))
    })
    .unwrap();
    let names = |loso: &Loso| -> Vec<[String; 3]> {
        let first = loso.predictions.iter().filter(|prediction| prediction.epoch == 0);
        first.map(|p| [&p.dataset, &p.subject, &p.clip].map(String::clone)).collect()
    };
    assert_eq!(names(&loso), names(&ours));
    let subjects = |loso: &Loso| -> Vec<(String, usize, Vec<String>)> {
        let of = |fold: &srflow_mer::FoldRecord| (fold.name(), fold.clips, fold.unseen_classes.clone());
        loso.folds.iter().map(of).collect()
    };
    assert_eq!(subjects(&loso), subjects(&ours));
    assert_eq!(Summary::of(&loso.classes, &loso.predictions).unwrap().last().mean.accuracy, 1.0);

    let error = by(&mut |_| Ok(vec![3])).unwrap_err().to_string();
    assert!(
        error.contains("expected the classes of 6 clips, numbers from 0 to 2; found 1 numbers: [3]"),
        "{error}"
    );
    assert!(matches!(by(&mut |_| Err(LosoError::Stopped)), Err(LosoError::Stopped)));
}

#[test]
fn impossible_runs_are_explained() {
    let error = |samples: &[Sample], protocol: &Protocol| {
        let classes = Classes::default();
        leave_out(LeftOut::EachSubject, &STSTNET, samples, classes.names(), protocol, None, UNWATCHED)
            .unwrap_err()
            .to_string()
    };
    let all = samples(1);
    assert!(error(&[], &protocol(1)).contains("found none"));
    assert!(error(&all[..1], &protocol(1)).contains("at least 2 subjects; found b 99"));
    let twice = [all.clone(), all[3..4].to_vec()].concat();
    assert!(error(&twice, &protocol(1)).contains("subject 00 has two clips called clip 2"));
    assert!(error(&all, &Protocol { epochs: 0, ..protocol(1) }).contains("number of epochs is 0"));
    let steep = Protocol { learning_rate: 1e38, ..protocol(8) };
    assert!(error(&all, &steep).contains("diverged in epoch"));
}
