use maud::html;

use super::{Figure, Picture};

/// Two pictures of one size on top of each other with a draggable divider: `left` is visible to the left of it, `right` to
/// its right. The labels are shown in the corners; small pictures are enlarged to have place for them.
pub fn compare(left: (&Picture, &str), right: (&Picture, &str), caption: &str) -> Figure {
    Figure(html! {
        figure {
            div.compare style={ "max-width:" (left.0.size.width.max(260)) "px" } {
                (left.0.img())
                div.after { (right.0.img()) }
                span.tag.left { (left.1) }
                span.tag.right { (right.1) }
                input type="range" min="0" max="100" value="50" aria-label="divider"
                    oninput="this.parentNode.style.setProperty('--cut', this.value + '%')";
            }
            @if !caption.is_empty() { figcaption { (caption) } }
        }
    })
}
