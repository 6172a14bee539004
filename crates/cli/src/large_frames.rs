//! `--tile` and `--scale`: frames that are too large for the memory, or the time, there is.

use std::str::FromStr;

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use srflow_field::Size;
use srflow_nets::{SMALLEST_TILE_SIDE, TileSize, Tiles, Tiling, scaled_size};

use crate::machine;
use crate::methods::Method;
use crate::networks::NetworkArgs;
use crate::usage::wrong_usage;

/// Part of the free memory that `--tile auto` fills: frames and flows take some beside the network.
const MEMORY_SHARE: f64 = 0.8;
/// Tiles of methods that do not care where they start.
const CLASSICAL_ALIGNMENT: usize = 8;

/// How large frames are made to fit.
#[derive(Args, Debug, Clone, Default)]
#[command(next_help_heading = "Large frames")]
pub struct LargeFrames {
    /// Estimate tile by tile, blending where tiles overlap; `auto` takes the largest tiles that fit the free memory, or
    /// none where the whole frame does
    #[arg(long, value_name = "WIDTHxHEIGHT|auto")]
    tile: Option<Tile>,
    /// Pixels that neighbouring tiles share, up to half a tile
    #[arg(long, value_name = "PIXELS", default_value_t = 128, requires = "tile", value_parser = overlap)]
    tile_overlap: usize,
    /// Resize the frames by this factor first, and the flow back
    #[arg(long, value_name = "FACTOR", value_parser = factor)]
    pub scale: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Tile {
    Size(Size),
    Auto,
}

/// What a method sees of a frame.
#[derive(Debug, Serialize, PartialEq)]
pub struct Resolution {
    /// Width and height after `--scale`.
    width: usize,
    height: usize,
    /// Of each tile; where there is one alone it is the frame.
    tile_width: usize,
    tile_height: usize,
    tiles: usize,
}

fn factor(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(factor) if (1.0 / 64.0..=64.0).contains(&factor) => Ok(factor),
        _ => Err("expected a factor from 1/64 to 64, such as 0.5".to_owned()),
    }
}

fn overlap(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(pixels) if (8..=4096).contains(&pixels) => Ok(pixels),
        _ => Err("expected 8 to 4096 pixels".to_owned()),
    }
}

impl FromStr for Tile {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let size: Size = text.parse().map_err(|_| "expected WIDTHxHEIGHT in pixels, or auto".to_owned())?;
        if size.width.min(size.height) < SMALLEST_TILE_SIDE {
            return Err(format!("a tile has sides of {SMALLEST_TILE_SIDE} pixels or more"));
        }
        Ok(Self::Size(size))
    }
}

impl LargeFrames {
    /// Whether frames are not taken as they are.
    pub fn given(&self) -> bool {
        self.tile.is_some() || self.scale.is_some()
    }

    /// How frames are divided; `None` for frames as they are.
    ///
    /// # Errors
    /// When `auto` is asked for where nothing is known of the memory.
    pub fn tiling(&self, method: Method, network: &NetworkArgs) -> anyhow::Result<Option<Tiling>> {
        let alignment = match method {
            Method::Network(architecture) => architecture.facts().padding,
            _ => CLASSICAL_ALIGNMENT,
        };
        let size = self.tile_size(method, network)?;
        Ok(size.map(|size| Tiling { size, overlap: self.tile_overlap, alignment }))
    }

    fn tile_size(&self, method: Method, network: &NetworkArgs) -> anyhow::Result<Option<TileSize>> {
        Ok(match (self.tile, method) {
            (None, _) => None,
            (Some(Tile::Size(size)), _) => Some(TileSize::Fixed(size.width, size.height)),
            (Some(Tile::Auto), Method::Network(architecture)) => {
                if !network.on_cpu() {
                    wrong_usage!(
                        "--tile auto knows the memory of the machine, not of {}: give WIDTHxHEIGHT",
                        network.device
                    );
                }
                let free = machine::free_memory()
                    .context("--tile auto: the free memory is not known; give WIDTHxHEIGHT")?;
                let need = architecture.facts().memory.of_batch(network.batch);
                Some(TileSize::Fitting { need, bytes: (free as f64 * MEMORY_SHARE) as u64 })
            }
            (Some(Tile::Auto), _) => {
                wrong_usage!(
                    "--tile auto is for networks: give {} WIDTHxHEIGHT, or leave it out",
                    method.name()
                )
            }
        })
    }

    /// What a method sees of frames of `size`.
    ///
    /// # Errors
    /// As [`LargeFrames::tiling`], and when the memory is too small for any tile.
    pub fn resolution(
        &self,
        size: (usize, usize),
        method: Method,
        network: &NetworkArgs,
    ) -> anyhow::Result<Resolution> {
        let (width, height) = self.scale.map_or(size, |factor| scaled_size(size, factor));
        let (tile, tiles) = match self.tiling(method, network)? {
            Some(tiling) => {
                let tiles = Tiles::new((width, height), tiling)?;
                (tiles.size(), tiles.count())
            }
            None => ((width, height), 1),
        };
        Ok(Resolution { width, height, tile_width: tile.0, tile_height: tile.1, tiles })
    }
}
