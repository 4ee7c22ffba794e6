//! The outcome of a verification, as a document and as text.

use std::fmt;
use std::path::Path;

use serde::Serialize;
use sightline_certificate::Report;
use sightline_pvs::Pvs;
use sightline_viewcells::CellIndex;

use crate::words::plural;

/// The outcome of a verification. Its serialisation is the document that `sightline verify --json` prints.
/// Its display is the text of the command.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Verdict {
    /// Every checked claim of the certificates holds.
    Accepted(CertificateReport),
    /// Exact queries agree with every checked claim of a result of portals.
    AcceptedHidden(HiddenReport),
    /// A claim does not hold.
    Rejected(Rejection),
}

/// A claim that does not hold.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Rejection {
    /// False: the result is not accepted.
    pub accepted: bool,
    /// The cell of the claim. `None` if the claim is about the whole result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cell: Option<CellIndex>,
    /// The reason why the claim does not hold.
    pub reason: String,
    /// The path of the result, for the display.
    #[serde(skip)]
    pub result: String,
}

/// The outcome of a check that rejected no claim: the method, the numbers of all claims and of the checked
/// claims, and the sample.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(
    missing_docs,
    reason = "docs/interfaces.md describes the document of verify"
)]
pub struct CertificateReport {
    pub accepted: bool,
    pub method: String,
    pub cells: u32,
    pub pairs: u64,
    pub witnesses: u64,
    pub certificates: u64,
    pub meeting: u64,
    pub witnesses_checked: u64,
    pub certificates_checked: u64,
    pub meeting_checked: u64,
    pub hidden_by_surfaces: u64,
    pub hidden_in_boxes: u64,
    pub hidden_alone: u64,
    pub undecided: u64,
    pub cells_not_reached: u64,
    pub cell_pairs_hidden: u64,
    pub cell_boxes: u64,
    pub cell_boxes_checked: u64,
    pub without_area: u64,
    pub evidence_bytes: u64,
    pub sampled: bool,
    pub sample: Option<u64>,
    pub seed: Option<u64>,
}

impl Verdict {
    /// Returns true if all checked claims hold.
    pub fn is_accepted(&self) -> bool {
        !matches!(self, Self::Rejected(_))
    }

    /// Creates the verdict for a claim that does not hold, about a cell or about the whole result.
    pub(super) fn rejected(cell: Option<CellIndex>, reason: &str, result: &Path) -> Self {
        Self::Rejected(Rejection {
            accepted: false,
            cell,
            reason: reason.to_owned(),
            result: result.display().to_string(),
        })
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Accepted(report) => report.fmt(f),
            Self::AcceptedHidden(report) => report.fmt(f),
            Self::Rejected(rejection) => rejection.fmt(f),
        }
    }
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cell = self
            .cell
            .map_or(String::new(), |cell| format!(", cell {cell}"));
        write!(
            f,
            "REFUSED: {}{cell}: {}; the result is damaged or was altered, bake it again",
            self.result, self.reason
        )
    }
}

/// The outcome of a check of pairs that a result of portals calls hidden.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct HiddenReport {
    /// True: the result is accepted.
    pub accepted: bool,
    /// The method of the result.
    pub method: String,
    /// The number of cells of the result.
    pub cells: u32,
    /// The number of checked pairs.
    pub pairs: u64,
    /// The number of pairs that exact queries call hidden, too.
    pub hidden: u64,
    /// The number of pairs about which exact queries end undecided.
    pub undecided: u64,
    /// True: exact queries check only a sample of the pairs.
    pub sampled: bool,
}

impl fmt::Display for HiddenReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "accepted: of {} that the result calls hidden, exact queries confirm {}; {} are undecided",
            plural(self.pairs as usize, "pair"),
            self.hidden,
            self.undecided
        )
    }
}

impl CertificateReport {
    /// Creates the report of a checked result. `sample` is the number of pairs and the seed.
    pub(super) fn new(report: &Report, pvs: &Pvs, sample: Option<(u64, u64)>) -> Self {
        let t = &report.totals;
        Self {
            accepted: true,
            method: pvs.method().to_owned(),
            cells: report.cells,
            pairs: report.pairs,
            witnesses: t.witnesses.all,
            certificates: t.certificates.all,
            meeting: t.meeting.all,
            witnesses_checked: t.witnesses.checked,
            certificates_checked: t.certificates.checked,
            meeting_checked: t.meeting.checked,
            hidden_by_surfaces: t.hidden.by_surface,
            hidden_in_boxes: t.hidden.in_boxes,
            hidden_alone: t.hidden.alone,
            undecided: t.undecided,
            cells_not_reached: t.cells_unreached,
            cell_pairs_hidden: t.cells_apart,
            cell_boxes: t.apart.all,
            cell_boxes_checked: t.apart.checked,
            without_area: report.without_area(),
            evidence_bytes: t.bytes,
            sampled: sample.is_some(),
            sample: sample.map(|(pairs, _)| pairs),
            seed: sample.map(|(_, seed)| seed),
        }
    }
}

impl fmt::Display for CertificateReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "accepted{}: {} pairs of cell and triangle in {} cells\n\
             visible: {} with a witness ({} checked), {} meet their cell ({} checked)\n\
             hidden: {} by their own closed surface, {} in hidden boxes, {} by a proof for \
             the triangle or a polygon around it; {} certificates ({} checked), {} bytes with the witnesses\n\
             neither: {} undecided, {} without area{}{}",
            self.sample
                .map_or(String::new(), |n| format!(" by a sample of {n} pairs")),
            self.pairs,
            self.cells,
            self.witnesses,
            self.witnesses_checked,
            self.meeting,
            self.meeting_checked,
            self.hidden_by_surfaces,
            self.hidden_in_boxes,
            self.hidden_alone,
            self.certificates,
            self.certificates_checked,
            self.evidence_bytes,
            self.undecided,
            self.without_area,
            match self.cells_not_reached {
                0 => String::new(),
                n => format!(
                    "\n{n} of the cells contain no viewpoint, so the result makes no claim about them"
                ),
            },
            match self.cell_pairs_hidden {
                0 => String::new(),
                apart => format!(
                    "\ncells: {apart} pairs of cells do not see each other, proved by {} hidden boxes ({} \
                     checked)",
                    self.cell_boxes, self.cell_boxes_checked
                ),
            },
        )
    }
}
