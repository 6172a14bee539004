//! A dataset rasterized on a GPU is that of the CPU within the tolerance that docs/guides/gpu.md states.
//! `SRFLOW_TEST_DEVICE` names the
//! GPU; see docs/guides/gpu.md.

use srflow_data::manifest::Manifest;
use srflow_files::{read_flow, read_image, read_mask};
use srflow_render::check::check_rerendered;
use srflow_render::generate::{Settings, generate};
use srflow_render::job::Request;
use srflow_splat::Device;

use crate::tiny;

#[test]
fn a_dataset_from_a_gpu_is_that_of_the_cpu_within_the_tolerance() {
    let Ok(name) = std::env::var("SRFLOW_TEST_DEVICE") else {
        eprintln!("skipped: gpu: SRFLOW_TEST_DEVICE names no device");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let [on_cpu, on_gpu] = ["cpu", "gpu"].map(|name| folder.path().join(name));
    let settings = Settings { backward: true, regions: true, ..tiny::settings() };
    let elsewhere = Settings { device: Device::named(&name).unwrap(), ..settings.clone() };
    generate(&settings, Request::new(&on_cpu)).unwrap();
    generate(&elsewhere, Request::new(&on_gpu)).unwrap();

    let manifest = Manifest::read(&on_gpu).unwrap();
    assert_eq!(manifest.arguments.others["device"].as_str(), Some(elsewhere.device.kind()));
    let scene = &manifest.scenes[0];
    for frame in 0..=scene.pairs {
        let [here, there] = [&on_cpu, &on_gpu].map(|dir| manifest.frame_files(dir, scene, frame));
        let [a, b] = [&here.frame, &there.frame].map(|path| read_image(path).unwrap());
        for (a, b) in a.pixels().as_flattened().iter().zip(b.pixels().as_flattened()) {
            assert!(a.abs_diff(*b) <= 2, "{a} and {b} in frame {frame}");
        }
        let [a, b] = [&here.mask, &there.mask].map(|path| read_mask(path).unwrap());
        let different = a.pixels().iter().zip(b.pixels()).filter(|(a, b)| a != b).count();
        assert!(different * 1000 <= a.pixels().len(), "{different} pixels of the mask in frame {frame}");
    }
    for pair in 0..scene.pairs {
        let [here, there] = [&on_cpu, &on_gpu].map(|dir| manifest.files(dir, scene, pair));
        let mask = read_mask(&manifest.frame_files(&on_cpu, scene, pair).mask).unwrap();
        let [a, b] = [&here.flow, &there.flow].map(|path| read_flow(path).unwrap());
        let mut covered = 0;
        for ((a, b), inside) in a.pixels().iter().zip(b.pixels()).zip(mask.pixels()) {
            if *inside {
                covered += 1;
                let far = a.iter().zip(b).any(|(a, b)| (a - b).abs() > 0.01);
                assert!(!far, "{a:?} and {b:?} in pair {pair}");
            }
        }
        assert!(covered > 500, "{covered} pixels");
    }

    let refused = generate(&settings, Request::new(&on_gpu)).unwrap_err().to_string();
    assert!(refused.contains("device"), "{refused}");
    let refused = check_rerendered(&on_gpu, 1, 1, &|| ()).unwrap_err().to_string();
    assert!(refused.contains("GPU"), "{refused}");
}
