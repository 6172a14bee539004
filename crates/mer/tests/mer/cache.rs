//! The cache of features.

use srflow_files::write_npy;
use srflow_mer::{FeatureCache, Features, HeadMotion, SubtractedMotion};

fn features(value: f32) -> Features {
    Features::from_values(vec![value; Features::LEN]).unwrap()
}

#[test]
fn features_are_found_again_until_anything_changes() {
    let folder = tempfile::tempdir().unwrap();
    let (onset, apex) = (folder.path().join("a"), folder.path().join("b"));
    std::fs::write(&onset, "onset").unwrap();
    std::fs::write(&apex, "apex").unwrap();
    let cache = FeatureCache::open(&folder.path().join("cache")).unwrap();
    let key = cache.key(&onset, &apex, "farneback").unwrap();
    assert_eq!(cache.get(&key, HeadMotion::Keep), None);
    cache.put(&key, &features(0.25), None).unwrap();
    assert_eq!(cache.get(&key, HeadMotion::Keep), Some((features(0.25), None)));

    assert_ne!(cache.key(&onset, &apex, "tvl1").unwrap(), key);
    assert_ne!(cache.key(&apex, &onset, "farneback").unwrap(), key);
    std::fs::write(&onset, "onseta").unwrap();
    std::fs::write(&apex, "pex").unwrap();
    assert_ne!(cache.key(&onset, &apex, "farneback").unwrap(), key, "the same bytes, cut elsewhere");
    std::fs::write(&onset, "onset").unwrap();
    std::fs::write(&apex, "apex").unwrap();
    assert_eq!(cache.key(&onset, &apex, "farneback").unwrap(), key);
}

#[test]
fn features_without_the_heads_motion_say_what_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("a");
    std::fs::write(&picture, "picture").unwrap();
    let cache = FeatureCache::open(&folder.path().join("cache")).unwrap();
    let key = cache.key(&picture, &picture, "r").unwrap();
    let motion = SubtractedMotion {
        translation_px: [0.1, -2.5e-7],
        rotation_degrees: 1.0 / 3.0,
        scale: 1.01,
        deviation_px: 0.02,
    };
    cache.put(&key, &features(1.0), Some(&motion)).unwrap();
    assert_eq!(cache.get(&key, HeadMotion::Subtract), Some((features(1.0), Some(motion))));
    let json = folder.path().join("cache").read_dir().unwrap().map(|entry| entry.unwrap().path());
    let json =
        json.into_iter().find(|path| path.extension().is_some_and(|extension| extension == "json")).unwrap();
    std::fs::write(&json, r#"{"translation_px":[0.1"#).unwrap();
    assert_eq!(cache.get(&key, HeadMotion::Subtract), None);
}

#[test]
fn a_broken_file_is_computed_again() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("a");
    std::fs::write(&picture, "picture").unwrap();
    let cache = FeatureCache::open(folder.path()).unwrap();
    let key = cache.key(&picture, &picture, "r").unwrap();
    cache.put(&key, &features(1.0), None).unwrap();
    let mut files = folder.path().read_dir().unwrap().map(|entry| entry.unwrap().path());
    let file = files.find(|path| path.extension().is_some()).unwrap();
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    assert_eq!(cache.get(&key, HeadMotion::Keep), None);
    write_npy(&file, &[3, 2, 2], &[0.0; 12]).unwrap();
    assert_eq!(cache.get(&key, HeadMotion::Keep), None);
    cache.put(&key, &features(1.0), None).unwrap();
    assert_eq!(cache.get(&key, HeadMotion::Keep), Some((features(1.0), None)));
}

#[test]
fn a_picture_that_cannot_be_read_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let cache = FeatureCache::open(folder.path()).unwrap();
    let gone = folder.path().join("gone.png");
    assert!(cache.key(&gone, &gone, "r").unwrap_err().to_string().contains("gone.png: opening"));
}
