use maud::{DOCTYPE, Markup, PreEscaped, html};
use srflow_core::printable;

/// Pages load nothing and run no scripts, apart from the figures below.
const POLICY: &str =
    "default-src 'none'; base-uri 'none'; form-action 'none'; style-src 'unsafe-inline'; img-src data:";
/// A page [within a page](super::embedded) inherits the policy of the outer one and adds its own, which allows its own scripts alone.
const POLICY_OF_EMBEDDED: &str = "; script-src 'unsafe-inline'; worker-src blob:; connect-src data:";
/// A [timeline](super::timeline) shows a video from the user's disk, and its script moves it.
const POLICY_OF_TIMELINE: &str = "; script-src 'unsafe-inline'; media-src file:";
const PICTURES_OF_TIMELINE: &str = "img-src data: file:";

/// A part of a page, created by one of the figure functions of this module.
#[derive(Debug, Clone)]
pub struct Figure(pub(super) Markup);

/// A titled part of a [`Page`].
#[derive(Debug, Clone)]
pub struct Section {
    /// Heading, also in the table of contents.
    pub title: String,
    /// One or two sentences under the heading.
    pub lead: String,
    /// From top to bottom.
    pub figures: Vec<Figure>,
}

impl Section {
    /// A section of these figures.
    pub fn new(title: impl Into<String>, lead: impl Into<String>, figures: Vec<Figure>) -> Self {
        Self { title: title.into(), lead: lead.into(), figures }
    }
}

/// A page: title, contents, sections.
#[derive(Debug, Clone)]
pub struct Page {
    /// Heading, also the page's `<title>`.
    pub title: String,
    /// Small line above the heading.
    pub kicker: String,
    /// Two or three sentences that describe the page.
    pub lead: String,
    /// Shown above the first section: tiles, an animation.
    pub opening: Vec<Figure>,
    pub sections: Vec<Section>,
    /// The last line.
    pub colophon: String,
}

impl Page {
    /// The whole page as HTML 5, also well-formed as XML apart from the document type and void elements. Texts are escaped,
    /// and what would reorder or hide them is spelt out.
    pub fn html(&self) -> String {
        let contents = self.sections.len() > 1;
        let figures = || self.opening.iter().chain(self.sections.iter().flat_map(|section| &section.figures));
        let has = |element: &str| figures().any(|figure| figure.0.0.contains(element));
        let policy = match (has("<iframe"), has("<figure class=\"timeline\"")) {
            (_, true) => POLICY.replace("img-src data:", PICTURES_OF_TIMELINE) + POLICY_OF_TIMELINE,
            (true, false) => POLICY.to_owned() + POLICY_OF_EMBEDDED,
            (false, false) => POLICY.to_owned(),
        };
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta http-equiv="Content-Security-Policy" content=(policy);
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    meta name="generator" content=(concat!("srflow ", env!("CARGO_PKG_VERSION")));
                    title { (self.title) }
                    style { (PreEscaped(include_str!("page.css"))) }
                }
                body {
                    header.opening {
                        p.kicker { (self.kicker) }
                        h1 { (self.title) }
                        p.lead { (self.lead) }
                        @if contents {
                            nav {
                                @for (number, section) in self.sections.iter().enumerate() {
                                    a href={ "#part-" (number + 1) } { (section.title) }
                                }
                            }
                        }
                        @for figure in &self.opening { (figure.0) }
                    }
                    main {
                        @for (number, section) in self.sections.iter().enumerate() {
                            section id={ "part-" (number + 1) } {
                                div.heading {
                                    span.number { (number + 1) }
                                    h2 { (section.title) }
                                    p.lead { (section.lead) }
                                }
                                @for figure in &section.figures { (figure.0) }
                            }
                        }
                    }
                    footer { p { (self.colophon) } }
                }
            }
        };
        printable(&page.0).into_owned()
    }
}
