//! Rules by which nodes are removed.

use evergraph_model::FactorId;
use evergraph_removal::{Options, Order};

/// Rules by which [`Thinning::run`](crate::Thinning::run) removes nodes.
///
/// ```
/// use evergraph_longterm::Rules;
/// use evergraph_removal::Order;
///
/// let rules = Rules::default().with_order(Order::MinDegree).with_limit(100);
/// assert!(!rules.prices);
/// ```
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Rules<'a> {
    /// The order in which nodes go. Default: as given.
    pub order: Order,
    /// The largest number of removals; the rest of the nodes stays. With fewer removals than nodes, the
    /// order decides which nodes go, not only when. Default: no limit.
    pub limit: usize,
    /// The factors that take the place of a node.
    pub options: Options,
    /// Factors that are left alone while their variables stay
    /// ([`Removal::sparing`](evergraph_removal::Removal::sparing)), such as gauge priors. Default: none.
    pub spared: &'a [FactorId],
    /// Whether each removal is priced, which costs more than the removal. Default: no.
    pub prices: bool,
}

impl Default for Rules<'_> {
    fn default() -> Self {
        Self {
            order: Order::Given,
            limit: usize::MAX,
            options: Options::default(),
            spared: &[],
            prices: false,
        }
    }
}

impl<'a> Rules<'a> {
    /// Sets [`order`](Self::order).
    #[must_use]
    pub fn with_order(self, order: Order) -> Self {
        Self { order, ..self }
    }

    /// Sets [`limit`](Self::limit).
    #[must_use]
    pub fn with_limit(self, limit: usize) -> Self {
        Self { limit, ..self }
    }

    /// Sets [`options`](Self::options).
    #[must_use]
    pub fn with_options(self, options: Options) -> Self {
        Self { options, ..self }
    }

    /// Sets [`spared`](Self::spared).
    #[must_use]
    pub fn sparing(self, spared: &'a [FactorId]) -> Self {
        Self { spared, ..self }
    }

    /// Sets [`prices`](Self::prices).
    #[must_use]
    pub fn with_prices(self, prices: bool) -> Self {
        Self { prices, ..self }
    }
}
