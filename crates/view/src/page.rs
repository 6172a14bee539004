use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use maud::{DOCTYPE, PreEscaped, html};
use sha2::{Digest, Sha256};
use srflow_core::printable;

use crate::pack::Pack;

/// The scripts of a page, in an order in which what is used at once comes first.
const SCRIPTS: [&str; 9] = [
    include_str!("../page/pack.js"),
    include_str!("../page/colors.js"),
    include_str!("../page/elements.js"),
    include_str!("../page/camera.js"),
    include_str!("../page/head.js"),
    include_str!("../page/shading.js"),
    include_str!("../page/splats.js"),
    include_str!("../page/splat_page.js"),
    include_str!("../page/pairs_page.js"),
];

/// An HTML page.
#[derive(Debug, Clone, Default)]
pub struct Page {
    title: String,
    packs: Vec<(String, Vec<u8>)>,
}

impl Page {
    /// A page that fetches its packs from where it came from: `pack/main`, `pack/0` ...
    pub fn new(title: &str) -> Self {
        Self { title: title.to_owned(), packs: Vec::new() }
    }

    /// Embeds a pack, which is not fetched then.
    pub fn embed(&mut self, name: impl Into<String>, pack: &Pack) {
        self.packs.push((name.into(), pack.gzipped()));
    }

    /// The page as HTML 5. It loads nothing but packs that are not embedded.
    pub fn html(&self) -> String {
        let scripts = SCRIPTS.join("\n") + include_str!("../page/main.js");
        // The page runs its own script alone, and fetches only from its server and from its own data.
        let policy = format!(
            "default-src 'none'; base-uri 'none'; form-action 'none'; script-src 'sha256-{}'; worker-src blob:; \
             style-src 'unsafe-inline'; img-src data:; connect-src 'self' data:",
            BASE64_STANDARD.encode(Sha256::digest(&scripts))
        );
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta http-equiv="Content-Security-Policy" content=(policy);
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    meta name="generator" content=(concat!("srflow ", env!("CARGO_PKG_VERSION")));
                    link rel="icon" href="data:,";
                    title { (printable(&self.title)) }
                    style { (PreEscaped(include_str!("../page/page.css"))) }
                }
                body {
                    main id="view" {}
                    script type="text/plain" id="sort" { (PreEscaped(include_str!("../page/sort.js"))) }
                    @for (name, bytes) in &self.packs {
                        script type="text/plain" id={ "pack-" (name) } { (PreEscaped(BASE64_STANDARD.encode(bytes))) }
                    }
                    script { (PreEscaped(scripts)) }
                }
            }
        };
        page.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pairs;

    #[test]
    fn a_page_carries_its_packs_and_no_link() {
        let mut page = Page::new("a < b");
        page.embed("main", &pairs("a < b", "", &["one".to_owned()]));
        let html = page.html();
        assert!(html.contains("<title>a &lt; b</title>") && html.contains("id=\"pack-main\""));
        assert!(!html.contains("http://") && !html.contains("https://"));
        assert_eq!(html.matches("</script>").count(), html.matches("<script").count());
    }
}
