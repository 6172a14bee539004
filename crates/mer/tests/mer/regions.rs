//! Regions of a face, and the motion of action units.

use srflow_core::Plane;
use srflow_face::AVERAGE_FACE;
use srflow_mer::spotting::{ACTION_UNITS, REGIONS, RegionMotion, candidate_units, unit_motion};
use srflow_mer::{FEATURE_SIDE, Features, RegionFlow, RegionMap, Regions};

/// The name of the region at a place in shares of the sides.
fn name_at(map: &RegionMap, names: &[&'static str], [x, y]: [f64; 2]) -> Option<&'static str> {
    let [x, y] = [x, y].map(|share| (share * FEATURE_SIDE as f64) as usize);
    let label = map.labels()[y * FEATURE_SIDE + x];
    label.checked_sub(1).map(|number| names[usize::from(number)])
}

#[test]
fn parts_lie_where_their_names_say() {
    let names = Regions::Parts.names();
    let map = Regions::Parts.map(&AVERAGE_FACE);
    for (point, name) in [
        (19, "brow-left"),
        (24, "brow-right"),
        (30, "nose"),
        (31, "nostril-left"),
        (48, "mouth-corner-left"),
        (54, "mouth-corner-right"),
    ] {
        assert_eq!(name_at(&map, &names, AVERAGE_FACE[point]), Some(name));
    }
    assert_eq!(name_at(&map, &names, [0.3, 0.36]), Some("eye-left"));
    assert_eq!(name_at(&map, &names, [0.5, 0.84]), Some("lower-lip"));
    assert_eq!(name_at(&map, &names, [0.02, 0.95]), None);
}

#[test]
fn every_region_is_seen_and_has_its_mirror_image() {
    for regions in [Regions::Parts, Regions::Mdmo] {
        let map = regions.map(&AVERAGE_FACE);
        let rows: Vec<&[u8]> = map.labels().chunks_exact(FEATURE_SIDE).collect();
        for (number, name) in (1..).zip(regions.names()) {
            let count = map.labels().iter().filter(|label| **label == number).count();
            assert!(count >= 20, "{name}: {count} pixels");
        }
        // All but pixels on borders, and the ends of MDMO's temples, which its table draws unlike.
        let same = |x: usize, y: usize| (rows[y][x] > 0) == (rows[y][FEATURE_SIDE - 1 - x] > 0);
        let unlike =
            (0..FEATURE_SIDE * FEATURE_SIDE).filter(|at| !same(at % FEATURE_SIDE, at / FEATURE_SIDE));
        assert!(unlike.count() < 300, "{regions}");
    }
    assert_eq!(Regions::Mdmo.names().len(), 36);
}

#[test]
fn a_region_moves_as_most_of_its_pixels() {
    let map = Regions::Parts.map(&AVERAGE_FACE);
    let chin = Regions::Parts.names().iter().position(|name| *name == "chin").unwrap();
    let of_chin = |at: usize| usize::from(map.labels()[at]) == chin + 1;
    // Two of three pixels go up by 1, the others far to the left; what is no chin goes down.
    let mut number = 0;
    let flow: Vec<[f32; 2]> = (0..FEATURE_SIDE * FEATURE_SIDE)
        .map(|at| {
            number += usize::from(of_chin(at));
            match (of_chin(at), number % 3) {
                (true, 0) => [-9.0, 0.5],
                (true, _) => [0.25, -1.0],
                (false, _) => [0.0, 50.0],
            }
        })
        .collect();
    let plane = |of: &dyn Fn([f32; 2]) -> f32| {
        Plane::from_fn(FEATURE_SIDE, FEATURE_SIDE, |x, y| of(flow[y * FEATURE_SIDE + x]))
    };
    let features = Features::new(&plane(&|[u, _]| u), &plane(&|[_, v]| v), &plane(&|_| 0.25)).unwrap();
    let RegionFlow { mean, strain, main } = map.flow(&features)[chin].unwrap();
    assert_eq!((main, strain), ([0.25, -1.0], 0.25));
    assert!((mean[0] + 2.8).abs() < 0.1 && (mean[1] + 0.5).abs() < 0.05, "{mean:?}");
    // A region that the crop does not show has no motion.
    let below = AVERAGE_FACE.map(|[x, y]| [x, y + 2.0]);
    assert!(Regions::Parts.map(&below).flow(&features).iter().all(Option::is_none));
}

#[test]
fn units_are_known_by_their_directions() {
    let moving = |moves: &[(&str, [f64; 2])]| -> RegionMotion {
        REGIONS.map(|region| moves.iter().find(|(name, _)| *name == region).map_or([0.0; 2], |(_, by)| *by))
    };
    let smile = moving(&[("mouth-corner-left", [-1.0, -1.0]), ("mouth-corner-right", [1.0, -1.0])]);
    assert_eq!(candidate_units(&smile), [12]);
    let brows = ["inner-brow-left", "inner-brow-right", "outer-brow-left", "outer-brow-right"];
    assert_eq!(candidate_units(&moving(&brows.map(|brow| (brow, [0.0, -2.0])))), [1, 2]);
    let frown = [("inner-brow-left", [0.5, 0.5]), ("inner-brow-right", [-0.5, 0.5])];
    let moved = unit_motion(&moving(&frown));
    let of_unit = |unit| moved[ACTION_UNITS.iter().position(|known| *known == unit).unwrap()];
    assert_eq!((of_unit(1), of_unit(2)), (-0.5, 0.0), "down is the other way");
    assert!((of_unit(4) - 0.5_f64.sqrt()).abs() < 1e-12);
    assert_eq!(candidate_units(&moving(&frown)), [4]);
    assert!(candidate_units(&moving(&[])).is_empty());
}
