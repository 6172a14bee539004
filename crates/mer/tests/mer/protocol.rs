//! The training protocol.

use srflow_mer::{Augment, Balance, Protocol};

#[test]
fn the_papers_schedule() {
    let protocol = Protocol::default();
    protocol.check().unwrap();
    assert_eq!(protocol.recorded(), [0, 20, 40, 60, 80, 100, 120, 140, 160, 180, 200]);
    let rates = [0, 59, 60, 119, 120, 200].map(|epoch| protocol.learning_rate(epoch));
    for (rate, power) in rates.iter().zip([0, 0, 1, 1, 2, 3]) {
        assert!((rate - 6.5e-4 * 0.3_f64.powi(power)).abs() < 1e-18, "{rates:?}");
    }
}

#[test]
fn the_last_epoch_is_always_recorded() {
    assert_eq!(Protocol { epochs: 50, ..Protocol::default() }.recorded(), [0, 20, 40, 49]);
    assert_eq!(Protocol { epochs: 1, ..Protocol::default() }.recorded(), [0]);
}

#[test]
fn values_that_make_no_sense_are_named() {
    let error = Protocol { batch: 0, ..Protocol::default() }.check().unwrap_err().to_string();
    assert_eq!(error, "batch size is 0; expected at least 1");
    for seeds in [0, 1_000_000_000] {
        let error = Protocol { seeds, ..Protocol::default() }.check().unwrap_err().to_string();
        assert_eq!(error, format!("number of seeds is {seeds}; expected 1 to 1000"));
    }
    for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(Protocol { learning_rate: rate, ..Protocol::default() }.check().is_err(), "{rate}");
    }
    assert!(Protocol { decay: 1.5, ..Protocol::default() }.check().is_err());
}

#[test]
fn the_identity_in_the_names_of_stored_folds_does_not_change() {
    let protocol = Protocol { learning_rate: 1e-5, decay: 1.0, ..Protocol::default() };
    assert_eq!(
        protocol.identity(),
        "Protocol { epochs: 201, record_every: 20, batch: 64, learning_rate: 1e-5, decay_every: 60, decay: 1.0, seed: 0 }"
    );
    let balanced = Protocol { balance: Balance::Weights, ..Protocol::default() };
    assert!(balanced.identity().ends_with("seed: 0, balance: weights }"), "{}", balanced.identity());
    let mirrored = Protocol { augment: Augment::Mirror, ..Protocol::default() };
    assert!(mirrored.identity().ends_with("seed: 0, augment: mirror }"), "{}", mirrored.identity());
}
