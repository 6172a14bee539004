//! From clips on disk to features: whole, in order, cached by what they follow from; and the apex where there is none.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use srflow_core::{EstimateError, FlowEstimator, FlowField, Image};
use srflow_data::micro_expression::{Annotation, Classes, Clip, ClipDataset, write_plain};
use srflow_files::write_image_png;
use srflow_mer::{
    ApexRule, Channel, Extracted, FaceCrop, FeatureCache, FeatureSettings, HeadMotion, Landmarks, Method,
    Preparation, ResizeOrder, apex_errors, extract, fill_apexes, spot_apex,
};

/// Takes the change of brightness for a stretching flow, and counts how often it is asked.
#[derive(Default)]
struct Brightness(AtomicUsize);

impl FlowEstimator for Brightness {
    fn name(&self) -> &str {
        "brightness"
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        self.0.fetch_add(1, Ordering::Relaxed);
        let change = |x, y| f32::from(frame2.get(x, y)[0]) - f32::from(frame1.get(x, y)[0]);
        Ok(FlowField::from_fn(frame1.width(), frame1.height(), |x, y| [0.01 * change(x, y) * x as f32, 0.5]))
    }
}

const APEXES: [u64; 3] = [5, 3, 7];

/// Three clips of ten frames, one brighter than the other; a patch in the middle grows brighter up to the apex and fades.
fn clips(folder: &Path, apexes_known: bool) -> Vec<Clip> {
    let mut rows = Vec::new();
    for (number, apex) in APEXES.into_iter().enumerate() {
        let clip = format!("c{number}");
        let base = 80 + 10 * number as u8; // pictures of their own: equal ones share their features
        std::fs::create_dir_all(folder.join(&clip)).unwrap();
        for frame in 0..10_u64 {
            let strength = if frame <= apex {
                frame as f64 / apex as f64
            } else {
                (10 - frame) as f64 / (10 - apex) as f64
            };
            let image = Image::from_fn(60, 50, |x, y| {
                let inside = (20..40).contains(&x) && (15..35).contains(&y);
                [if inside { base + (60.0 * strength) as u8 } else { base }; 3]
            });
            write_image_png(&folder.join(&clip).join(format!("f{frame:02}.png")), &image).unwrap();
        }
        rows.push(Annotation {
            subject: format!("s{number}"),
            clip,
            class: number,
            label: String::new(),
            action_units: String::new(),
            onset: 0,
            apex: apexes_known.then_some(apex),
            offset: 9,
        });
    }
    write_plain(&folder.join("clips.csv"), &Classes::default(), &rows).unwrap();
    ClipDataset::open(&format!("clips:{}", folder.display()).parse().unwrap(), false).unwrap().clips
}

#[test]
fn features_come_in_order_and_from_the_cache_the_second_time() {
    let folder = tempfile::tempdir().unwrap();
    let clips = clips(folder.path(), true);
    let cache = FeatureCache::open(&folder.path().join("cache")).unwrap();
    let estimator = Brightness::default();
    let run = |identity: &str, preparation: &Preparation| {
        let method = Method { estimator: &estimator, identity: identity.to_owned() };
        let cached = AtomicUsize::new(0);
        let on_clip = |clip: Extracted| _ = cached.fetch_add(usize::from(clip.cached), Ordering::Relaxed);
        let samples = extract(&clips, &method, preparation, Some(&cache), &on_clip, &|| false);
        (samples.unwrap(), cached.load(Ordering::Relaxed), estimator.0.swap(0, Ordering::Relaxed))
    };
    let kept = |resize| Preparation {
        features: FeatureSettings { resize, head_motion: HeadMotion::Keep, ..FeatureSettings::default() },
        ..Preparation::default()
    };
    let before = kept(ResizeOrder::Before);
    let (first, cached, estimated) = run("brightness 1", &before);
    assert_eq!((cached, estimated), (0, 3));
    let named: Vec<(&str, usize)> = first.iter().map(|s| (s.subject.as_str(), s.class)).collect();
    assert_eq!(named, [("s0", 0), ("s1", 1), ("s2", 2)]);
    assert!(first.iter().all(|sample| sample.features.channel(Channel::V).iter().all(|v| *v == 0.5)));
    assert!(
        first.iter().all(|sample| sample
            .features
            .channel(Channel::Strain)
            .iter()
            .any(|strain| *strain > 0.1))
    );

    assert_eq!(run("brightness 1", &before), (first.clone(), 3, 0));
    assert_eq!(run("brightness 2", &before).2, 3, "other parameters");
    let after = kept(ResizeOrder::After);
    let (resized, _, estimated) = run("brightness 1", &after);
    assert_eq!(estimated, 3);
    // v is half a pixel of 50 rows, and of 112 rows in proportion.
    assert!((resized[0].features.channel(Channel::V)[5000] - 0.5 * 112.0 / 50.0).abs() < 1e-4);
    let cut = Preparation { face: FaceCrop::Fixed("10,5,40x40".parse().unwrap()), ..before.clone() };
    assert_eq!(run("brightness 1", &cut).2, 3, "another crop");

    let subtracted = Preparation::default();
    let (without, _, estimated) = run("brightness 1", &subtracted);
    assert_eq!(estimated, 3);
    // Half a pixel of 50 rows is the head's motion, and no longer in the flow.
    let motion = without[0].head_motion.unwrap();
    assert!((motion.translation_px[1] - 0.5 * 112.0 / 50.0).abs() < 1e-3, "{motion:?}");
    assert!(without[0].features.channel(Channel::V).iter().all(|v| v.abs() < 1e-3));
    assert_eq!(run("brightness 1", &subtracted), (without, 3, 0));
}

#[test]
fn clips_that_cannot_be_used_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut clips = clips(folder.path(), true);
    let estimator = Brightness::default();
    let method = Method { estimator: &estimator, identity: String::new() };
    let error = |clips: &[Clip], face: FaceCrop| {
        let preparation = Preparation { face, ..Preparation::default() };
        extract(clips, &method, &preparation, None, &|_| {}, &|| false).unwrap_err().to_string()
    };
    let outside = error(&clips, FaceCrop::Fixed("10,5,400x40".parse().unwrap()));
    assert!(outside.contains("s0/c0: the box 10,5,400x40") && outside.contains("60x50"), "{outside}");

    let file = folder.path().join("landmarks.csv");
    let eyes = "subject,clip,left_eye_x,left_eye_y,right_eye_x,right_eye_y\ns0,c0,20,20,40,20\n";
    std::fs::write(&file, eyes).unwrap();
    let absent = error(&clips, FaceCrop::Landmarks(Landmarks::read(&file).unwrap()));
    assert!(absent.contains("s1/c1") && absent.contains("no landmarks of clip c1 of subject s1"), "{absent}");

    let apex = clips[1].frames[&APEXES[1]].clone();
    write_image_png(&apex, &Image::new(61, 50)).unwrap();
    let sizes = error(&clips, FaceCrop::Whole);
    assert!(sizes.contains("61x50") && sizes.contains("f03.png"), "{sizes}");
    std::fs::write(&apex, "no picture").unwrap();
    let broken = error(&clips, FaceCrop::Whole);
    assert!(broken.contains("f03.png: magic"), "{broken}");

    clips[0].annotation.apex = None;
    let unknown = error(&clips, FaceCrop::Whole);
    assert!(unknown.contains("s0/c0: it has no apex frame"), "{unknown}");
}

/// Without a fit to the head: the flow of [`Brightness`] is no head's.
fn kept() -> Preparation {
    let features = FeatureSettings { head_motion: HeadMotion::Keep, ..FeatureSettings::default() };
    Preparation { face: FaceCrop::Whole, features }
}

#[test]
fn apexes_are_spotted_by_every_rule() {
    let folder = tempfile::tempdir().unwrap();
    let clips = clips(folder.path(), true);
    let estimator = Brightness::default();
    for rule in ApexRule::ALL {
        let spot = |clip: &Clip| spot_apex(clip, rule, &kept(), &estimator).unwrap();
        let spotted: Vec<u64> = clips.iter().map(|clip| spot(clip).frame).collect();
        let errors = apex_errors(clips.iter().zip(spotted.iter().copied())).unwrap();
        assert_eq!(errors.clips, 3);
        assert!((errors.of_the_middle - (1.0 + 1.0 + 3.0) / 3.0).abs() < 1e-12);
        if rule == ApexRule::Strain {
            assert_eq!((spotted, errors.mean_absolute), (APEXES.to_vec(), 0.0));
        } else {
            assert!(errors.mean_absolute <= 2.0, "{spotted:?}");
        }
        assert_eq!(spot(&clips[0]).scores.len(), 9, "every frame after the onset");
    }
}

#[test]
fn only_missing_apexes_are_filled() {
    let folder = tempfile::tempdir().unwrap();
    let mut clips = clips(folder.path(), false);
    clips[1].annotation.apex = Some(8);
    let filled = fill_apexes(&mut clips, ApexRule::Strain, &kept(), &Brightness::default(), &|| ()).unwrap();
    let apexes: Vec<Option<u64>> = clips.iter().map(|clip| clip.annotation.apex).collect();
    assert_eq!((filled, apexes), (2, vec![Some(5), Some(8), Some(7)]));
    assert_eq!(apex_errors([]), None);
}
