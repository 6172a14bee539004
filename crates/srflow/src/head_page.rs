//! The page of a head in motion, for browsers.

use srflow_view::{Pack, Page, ViewedMotion};

use crate::posed_head::{FRAMES_PER_SECOND, MovingHead};

/// The data of the page.
///
/// # Errors
/// When the head has no Gaussians.
pub fn head_pack(head: &MovingHead, title: &str) -> anyhow::Result<Pack> {
    let motion = ViewedMotion { poses: head.poses(), frames_per_second: FRAMES_PER_SECOND };
    Ok(srflow_view::avatar(title, &head.avatar, &motion)?)
}

/// The page.
///
/// # Errors
/// When the head has no Gaussians.
pub fn head_page(head: &MovingHead, title: &str) -> anyhow::Result<Page> {
    let mut page = Page::new(title);
    page.embed("main", &head_pack(head, title)?);
    Ok(page)
}
