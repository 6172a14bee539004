//! The dataset card: `README.md` with the front matter that Hugging Face reads, and pictures.

use std::fmt::Write as _;
use std::path::Path;

use srflow_core::resize::resize_image_antialiased;
use srflow_core::{Image, Size, flow_colors};
use srflow_files::{create_folder, read_flow, read_image, write_image_png};

use crate::error::PackError;
use crate::index::FlowStatistics;
use crate::names::{about_field, field_of};
use crate::packed::{Packed, WholeTar};
use crate::settings::PackedFlow;
use crate::source::Source;
use crate::split::SceneSplit;

pub(crate) const NAME: &str = "README.md";
pub(crate) const PICTURES: &str = "images";

/// Width of a frame in the pictures, in pixels.
const WIDTH: usize = 320;
const SHOWN: u64 = 3;

/// Path of the picture of a pair in the folder, with `/`.
pub(crate) fn picture(key: &str) -> String {
    format!("{PICTURES}/{key}.png")
}

/// Writes pictures of some pairs, spread over the first split that has any, and returns their keys.
pub(crate) fn write_pictures(source: &Source, out: &Path) -> Result<Vec<String>, PackError> {
    create_folder(&out.join(PICTURES))?;
    let mut keys = Vec::new();
    let Some(split) = SceneSplit::ALL.into_iter().find(|split| source.pairs(*split) > 0) else {
        return Ok(keys);
    };
    let pairs = source.pairs(split);
    let shown = SHOWN.min(pairs);
    for number in 0..shown {
        source.each(split, pairs * (2 * number + 1) / (2 * shown), 1, |pair| {
            let frames = pair.copied().filter(|(field, _)| field.starts_with("frame"));
            let mut pictures: Vec<Image> = Vec::new();
            for (_, path) in frames {
                pictures.push(shrunk(&read_image(path)?));
            }
            pictures.push(shrunk(&flow_colors(&read_flow(&pair.flow)?, None)));
            let key = pair.key();
            write_image_png(&out.join(PICTURES).join(format!("{key}.png")), &Image::beside(&pictures))?;
            keys.push(key);
            Ok::<_, PackError>(())
        })?;
    }
    Ok(keys)
}

fn shrunk(image: &Image) -> Image {
    let Size { width, height } = image.size();
    if width <= WIDTH {
        return image.clone();
    }
    resize_image_antialiased(image, Size::new(WIDTH, (height * WIDTH / width).max(1)))
}

/// The text of the card.
pub(crate) fn text(packed: &Packed) -> String {
    let mut text = front_matter(packed);
    let total: u64 = packed.tars.iter().map(|tar| tar.pairs).sum();
    let size = packed.source.size;
    let faces = packed.source.faces;
    let (title, about) = if faces {
        (
            "SRFlow: facial optical flow",
            "rendered heads that move, with the exact optical flow of every pixel",
        )
    } else {
        (
            "Generic pairs with exact optical flow",
            "random shapes and textures that move, with the exact optical flow of every pixel",
        )
    };
    // Writing to a text cannot fail.
    let _ = writeln!(text, "# {title}\n");
    let _ = writeln!(
        text,
        "{total} pairs of frames of {size} (WIDTHxHEIGHT): {about}. Made by `{}` of srflow {}; \
         `pack.json` has its arguments, from which the same command makes the same dataset.\n",
        packed.source.command,
        env!("CARGO_PKG_VERSION")
    );
    for key in &packed.shown {
        let _ = writeln!(text, "![{key}: frame 1, frame 2, flow]({})\n", picture(key));
    }
    text += &statistics(packed, faces);
    text += &members(packed);
    text += &reading(packed);
    text
}

fn front_matter(packed: &Packed) -> String {
    let total: u64 = packed.tars.iter().map(|tar| tar.pairs).sum();
    let name = if packed.source.faces { "SRFlow" } else { "Generic pairs with exact optical flow" };
    let mut text = format!(
        "---\npretty_name: {name}\nlicense: other # choose one\ntask_categories:\n- image-to-image\ntags:\n- optical-flow\n\
         - synthetic\n- webdataset\nsize_categories:\n- {}\nconfigs:\n- config_name: default\n  data_files:\n",
        size_category(total)
    );
    for (split, _) in splits(packed) {
        let name = if split == SceneSplit::Val { "validation" } else { split.name() };
        let _ = writeln!(text, "  - split: {name}\n    path: {split}-*.tar");
    }
    text + "---\n\n"
}

/// The splits that have pairs, with the statistics of their tars.
fn splits(packed: &Packed) -> Vec<(SceneSplit, WholeTar)> {
    let mut splits: Vec<(SceneSplit, WholeTar)> = Vec::new();
    for tar in packed.tars {
        match splits.last_mut() {
            Some((split, sum)) if *split == tar.split => {
                sum.pairs += tar.pairs;
                sum.size += tar.size;
                sum.flow.add(&tar.flow);
                sum.flow_error = sum.flow_error.max(tar.flow_error);
            }
            _ => splits.push((tar.split, tar.clone())),
        }
    }
    splits
}

/// Hugging Face's name for a number of samples.
fn size_category(pairs: u64) -> &'static str {
    match pairs {
        0..1_000 => "n<1K",
        1_000..10_000 => "1K<n<10K",
        10_000..100_000 => "10K<n<100K",
        100_000..1_000_000 => "100K<n<1M",
        1_000_000..10_000_000 => "1M<n<10M",
        _ => "n>10M",
    }
}

fn statistics(packed: &Packed, faces: bool) -> String {
    let mut text = String::from("## Statistics\n\n");
    let on = if faces { " on the head" } else { "" };
    let scenes = if faces { " scenes |" } else { "" };
    let _ = writeln!(
        text,
        "| split |{scenes} pairs | tars | size | mean flow{on} | largest | occluded |\n|---|{}---|---|---|---|---|---|",
        if faces { "---|" } else { "" }
    );
    for (split, sum) in splits(packed) {
        let scenes =
            if faces { format!(" {} |", packed.source.scenes_of(split).count()) } else { String::new() };
        let tars = packed.tars.iter().filter(|tar| tar.split == split).count();
        let FlowStatistics { pixels, occluded, max, .. } = sum.flow;
        let _ = writeln!(
            text,
            "| {split} |{scenes} {} | {tars} | {:.3} GB | {:.3} px | {max:.1} px | {:.2} % |",
            sum.pairs,
            sum.size as f64 / 1e9,
            sum.flow.mean(),
            100.0 * occluded as f64 / pixels.max(1) as f64,
        );
    }
    text.push('\n');
    text
}

fn members(packed: &Packed) -> String {
    let mut text = String::from(
        "## Members\n\nEach sample is a pair of frames; its members are named `KEY.FIELD`. `index.jsonl` has a line for each sample: its \
         split, scene and frame, its tar, where its members are in it, and their SHA-256.\n\n| field | content |\n|---|---|\n",
    );
    for ending in &packed.fields {
        let format = if field_of(ending).starts_with("flow") {
            format!("; {}", packed.settings.flow.about())
        } else {
            String::new()
        };
        let _ = writeln!(text, "| `{ending}` | {}{format} |", about_field(ending));
    }
    let error = packed.tars.iter().map(|tar| tar.flow_error).fold(0.0, f32::max);
    let _ = match error {
        0.0 => writeln!(text, "\nThe flow is that of the dataset, to the last bit.\n"),
        _ => writeln!(
            text,
            "\nThe flow differs from that of the dataset by at most {error:.2e} px, from rounding.\n"
        ),
    };
    text
}

fn reading(packed: &Packed) -> String {
    let split = packed.tars.first().map_or(SceneSplit::Train, |tar| tar.split);
    let tars = packed.tars.iter().filter(|tar| tar.split == split).count();
    let last = tars.saturating_sub(1);
    let flow = match packed.settings.flow {
        PackedFlow::Npy | PackedFlow::Npy32 => "sample[\"flow.npy\"]  # H x W x 2",
        PackedFlow::Png => "sample[\"flow.png\"]",
        PackedFlow::Npz16 => "sample[\"flow.npz16\"]",
    };
    format!(
        "## Reading\n\n```python\nimport webdataset\n\nurl = \"{split}-{{000000..{last:06}}}.tar\"  # or https://HOST/FOLDER/ before it\n\
         for sample in webdataset.WebDataset(url, shardshuffle=False).decode(\"rgb8\"):\n    frame1, flow = sample[\"frame1.png\"], {flow}\n```\n\n\
         ```python\nfrom datasets import load_dataset\n\ndataset = load_dataset(\"OWNER/NAME\", streaming=True)\n```\n\n\
         ```sh\nsrflow eval --dataset wds:https://HOST/FOLDER --split {split} --method farneback\nsha256sum -c SHA256SUMS\n```\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_the_names_of_hugging_face() {
        let names = [1, 999, 1000, 11_161, 1_000_000, 20_000_000].map(size_category);
        assert_eq!(names, ["n<1K", "n<1K", "1K<n<10K", "10K<n<100K", "1M<n<10M", "n>10M"]);
    }
}
