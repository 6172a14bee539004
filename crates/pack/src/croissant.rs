//! `croissant.json`: the dataset described for programs, as Croissant 1.1 (<https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html>).

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::index::INDEX_NAME;
use crate::names::{about_field, field_of};
use crate::packed::Packed;

pub(crate) const NAME: &str = "croissant.json";

/// The text of the file. `hashes` are the SHA-256 of the files by name.
pub(crate) fn text(packed: &Packed, hashes: &BTreeMap<String, String>) -> String {
    let mut text = serde_json::to_string_pretty(&content(packed, hashes)).unwrap_or_default();
    text.push('\n');
    text
}

fn content(packed: &Packed, hashes: &BTreeMap<String, String>) -> Value {
    let (name, about) = if packed.source.faces {
        ("SRFlow", "Rendered heads that move, with the exact optical flow of every pixel.")
    } else {
        ("Generic-pairs", "Random shapes and textures that move, with the exact optical flow of every pixel.")
    };
    let members = packed.fields.iter().map(|ending| member_records(ending));
    let record_sets: Vec<Value> = [index_records()].into_iter().chain(members).collect();
    json!({
        "@context": context(),
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": name,
        "description": about,
        "version": "1.0.0",
        "isLiveDataset": false,
        "distribution": distribution(packed, hashes),
        "recordSet": record_sets,
    })
}

/// The context that the specification prescribes.
fn context() -> Value {
    serde_json::from_str(include_str!("croissant_context.json")).expect("the file in the repository is JSON")
}

/// The files: the index, each tar, and the members of all tars by field.
fn distribution(packed: &Packed, hashes: &BTreeMap<String, String>) -> Vec<Value> {
    let mut files = vec![json!({
        "@type": "cr:FileObject",
        "@id": INDEX_NAME,
        "name": INDEX_NAME,
        "description": "Split, scene, frame, tar and members of each pair.",
        "contentUrl": INDEX_NAME,
        "encodingFormat": "application/jsonlines",
        "sha256": hashes.get(INDEX_NAME),
    })];
    files.extend(packed.tars.iter().map(|tar| {
        json!({
            "@type": "cr:FileObject",
            "@id": tar.name,
            "name": tar.name,
            "description": format!("{} pairs of the split {}.", tar.pairs, tar.split),
            "contentUrl": tar.name,
            "contentSize": format!("{} B", tar.size),
            "encodingFormat": "application/x-tar",
            "sha256": tar.sha256,
        })
    }));
    let tars: Vec<Value> = packed.tars.iter().map(|tar| json!({ "@id": tar.name })).collect();
    files.extend(packed.fields.iter().map(|ending| {
        json!({
            "@type": "cr:FileSet",
            "@id": set_of(ending),
            "name": set_of(ending),
            "description": format!("{}.", about_field(ending)),
            "containedIn": tars,
            "encodingFormat": encoding(ending),
            "includes": format!("*.{ending}"),
        })
    }));
    files
}

fn set_of(ending: &str) -> String {
    format!("files-{}", field_of(ending))
}

fn encoding(ending: &str) -> &'static str {
    match ending.rsplit('.').next() {
        Some("png") => "image/png",
        Some("json") => "application/json",
        _ => "application/octet-stream",
    }
}

/// The lines of the index.
fn index_records() -> Value {
    let field = |name: &str, data_type: &str, about: &str| {
        json!({
            "@type": "cr:Field",
            "@id": format!("index/{name}"),
            "name": name,
            "description": about,
            "dataType": data_type,
            "source": { "fileObject": { "@id": INDEX_NAME }, "extract": { "column": name } },
        })
    };
    json!({
        "@type": "cr:RecordSet",
        "@id": "index",
        "name": "index",
        "description": "What the index says of each pair.",
        "key": { "@id": "index/key" },
        "field": [
            field("key", "sc:Text", "First part of the names of its members."),
            field("split", "sc:Text", "train, val or test."),
            field("scene", "sc:Text", "Name of its scene."),
            field("frame", "sc:Text", "Name of the pair within its scene."),
            field("tar", "sc:Text", "Name of its tar."),
            field("offset", "sc:Integer", "Where the pair starts in its tar, in bytes."),
            field("size", "sc:Integer", "Size of its members with their headers, in bytes."),
            field("flow_error", "sc:Float", "Largest rounding error of the flow, in pixels."),
        ],
    })
}

/// The members of this name: a record for each pair, by its key.
fn member_records(ending: &str) -> Value {
    let field = field_of(ending);
    let file_set = json!({ "@id": set_of(ending) });
    let is_picture = ending.ends_with(".png") && !field.starts_with("flow");
    json!({
        "@type": "cr:RecordSet",
        "@id": field,
        "name": field,
        "description": format!("{}.", about_field(ending)),
        "key": { "@id": format!("{field}/key") },
        "field": [
            {
                "@type": "cr:Field",
                "@id": format!("{field}/key"),
                "name": "key",
                "description": "The pair's key in the index.",
                "dataType": "sc:Text",
                "source": {
                    "fileSet": file_set,
                    "extract": { "fileProperty": "filename" },
                    "transform": { "regex": "^(.*?)\\..*$" },
                },
            },
            {
                "@type": "cr:Field",
                "@id": format!("{field}/content"),
                "name": "content",
                "description": format!("{}.", about_field(ending)),
                "dataType": if is_picture { "sc:ImageObject" } else { "sc:Text" },
                "source": { "fileSet": file_set, "extract": { "fileProperty": "content" } },
            },
        ],
    })
}
