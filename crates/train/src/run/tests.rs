use srflow_core::{FlowField, Image};
use srflow_files::{write_flow, write_image_png};

use super::*;
use crate::made::only_files;

fn trainer(dir: &Path) -> (Trainer, Batch, Batch) {
    for i in 0..2 {
        let frame = |shift: f32| {
            Image::from_fn(64, 64, |x, y| {
                let wave = ((x as f32 - shift) * 0.31).sin() + (y as f32 * 0.27 + i as f32).sin();
                [(128.0 + 50.0 * wave) as u8; 3]
            })
        };
        let file = |ending: &str| dir.join(format!("p{i}_{ending}"));
        write_image_png(&file("img1.png"), &frame(0.0)).unwrap();
        write_image_png(&file("img2.png"), &frame(1.0)).unwrap();
        write_flow(&file("flow.flo"), &FlowField::filled(64, 64, [1.0, 0.0])).unwrap();
    }
    let text = format!(
        "[network]\narchitecture = \"raft-small\"\n[data]\ntrain = \"folder:{}\"\ncrop = \"64x64\"\n\
         [augmentation]\nkind = \"none\"\n[training]\nsteps = 9\nbatch = 1\niterations = 2\n",
        dir.display()
    );
    let config = Config::parse(&text, "test").unwrap();
    let set = Arc::new(TrainingSet::open(&config, &only_files).unwrap());
    let batch = Batch::new(&set.sample(0, 0, 1).unwrap());
    let mut broken = batch.clone();
    broken.first[7] = f32::NAN;
    (Trainer::new(&config, &[Device::flex()], &set, 1), batch, broken)
}

#[test]
fn a_skipped_step_changes_neither_weights_nor_optimizer() {
    let dir = tempfile::tempdir().unwrap();
    let (mut steady, batch, _) = trainer(dir.path());
    let (mut disturbed, _, broken) = trainer(dir.path());
    // Other tests may draw from the device's random numbers while parameters are drawn here.
    disturbed.values.clone_from(&steady.values);
    disturbed.replicas.fill(&steady.values);
    for trainer in [&mut steady, &mut disturbed] {
        assert!(trainer.step(std::slice::from_ref(&batch), &Ranks::new(&Alone)).unwrap().is_some());
    }
    let before = disturbed.checkpoint("");
    for in_a_row in 1..=2 {
        assert!(disturbed.step(std::slice::from_ref(&broken), &Ranks::new(&Alone)).unwrap().is_none());
        let Progress { step, skipped, skipped_in_a_row, .. } = disturbed.progress;
        assert_eq!((step, skipped, skipped_in_a_row), (1 + in_a_row, in_a_row, in_a_row));
    }
    let after = disturbed.checkpoint("");
    assert_eq!((&after.values, &after.optimizer), (&before.values, &before.optimizer));

    // The next step gives the same result as without the skipped ones.
    let [expected, found] = [&mut steady, &mut disturbed]
        .map(|trainer| trainer.step(std::slice::from_ref(&batch), &Ranks::new(&Alone)).unwrap().unwrap());
    assert_eq!((found.loss, found.gradient_norm), (expected.loss, expected.gradient_norm));
    assert_eq!((found.step, expected.step), (4, 2));
    assert_eq!((disturbed.progress.skipped, disturbed.progress.skipped_in_a_row), (2, 0));
    assert_ne!(disturbed.checkpoint("").values, before.values, "training continues");
    assert!(disturbed.values.iter().all(|value| value.is_finite()));
}
