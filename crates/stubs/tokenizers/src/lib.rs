//! What candle-core names of tokenizers, with nothing behind it; README.md says why.

/// Why nothing here works.
#[derive(Debug)]
pub struct Missing;

impl std::fmt::Display for Missing {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("this build has no tokenizers")
    }
}

impl std::error::Error for Missing {}

/// Text models.
pub mod models {
    /// Byte-pair encoding.
    pub mod bpe {
        use crate::Missing;

        /// Tokens and their numbers.
        pub type Vocab = std::collections::HashMap<String, u32>;

        /// A model; there is none.
        pub enum BPE {}

        impl BPE {
            /// Returns a builder that makes none.
            pub fn builder() -> BpeBuilder {
                BpeBuilder
            }
        }

        /// A builder that makes nothing.
        pub struct BpeBuilder;

        impl BpeBuilder {
            /// Drops both.
            pub fn vocab_and_merges(self, _vocab: Vocab, _merges: Vec<(String, String)>) -> BpeBuilder {
                self
            }

            /// Drops the token.
            pub fn unk_token(self, _token: String) -> BpeBuilder {
                self
            }

            /// Drops the choice.
            pub fn byte_fallback(self, _wanted: bool) -> BpeBuilder {
                self
            }

            /// Drops the choice.
            pub fn ignore_merges(self, _wanted: bool) -> BpeBuilder {
                self
            }

            /// Refused.
            pub fn build(self) -> Result<BPE, Missing> {
                Err(Missing)
            }
        }
    }
}

/// What changes text first.
pub mod normalizers {
    /// Any of them.
    pub struct NormalizerWrapper;

    /// Unicode's forms.
    pub mod unicode {
        /// The composed form.
        pub struct NFC;
    }

    impl From<unicode::NFC> for NormalizerWrapper {
        fn from(_: unicode::NFC) -> NormalizerWrapper {
            NormalizerWrapper
        }
    }
}

/// What cuts text first.
pub mod pre_tokenizers {
    /// Any of them.
    pub struct PreTokenizerWrapper;

    /// By bytes.
    pub mod byte_level {
        /// The step by bytes, which is also a decoder and a last step.
        #[derive(Default)]
        pub struct ByteLevel;

        impl ByteLevel {
            /// Drops the choices.
            pub fn new(_add_prefix_space: bool, _trim_offsets: bool, _use_regex: bool) -> ByteLevel {
                ByteLevel
            }
        }
    }

    /// Several in turn.
    pub mod sequence {
        /// Several in turn.
        pub struct Sequence;

        impl Sequence {
            /// Drops the steps.
            pub fn new(_steps: Vec<super::PreTokenizerWrapper>) -> Sequence {
                Sequence
            }
        }
    }

    /// By a pattern.
    pub mod split {
        use crate::Missing;
        use crate::tokenizer::SplitDelimiterBehavior;

        /// A pattern.
        pub enum SplitPattern {
            /// A regular expression.
            Regex(String),
        }

        /// A step; there is none.
        pub enum Split {}

        impl Split {
            /// Refused.
            pub fn new(
                _pattern: SplitPattern,
                _behaviour: SplitDelimiterBehavior,
                _invert: bool,
            ) -> Result<Split, Missing> {
                Err(Missing)
            }
        }
    }

    impl From<byte_level::ByteLevel> for PreTokenizerWrapper {
        fn from(_: byte_level::ByteLevel) -> PreTokenizerWrapper {
            PreTokenizerWrapper
        }
    }

    impl From<sequence::Sequence> for PreTokenizerWrapper {
        fn from(_: sequence::Sequence) -> PreTokenizerWrapper {
            PreTokenizerWrapper
        }
    }

    impl From<split::Split> for PreTokenizerWrapper {
        fn from(split: split::Split) -> PreTokenizerWrapper {
            match split {}
        }
    }
}

/// What makes text of tokens.
pub mod decoders {
    pub use crate::pre_tokenizers::byte_level;

    /// Any of them.
    pub struct DecoderWrapper;

    impl From<byte_level::ByteLevel> for DecoderWrapper {
        fn from(_: byte_level::ByteLevel) -> DecoderWrapper {
            DecoderWrapper
        }
    }
}

/// What changes tokens last.
pub mod processors {
    pub use crate::pre_tokenizers::byte_level;

    /// Any of them.
    #[derive(Clone)]
    pub enum PostProcessorWrapper {
        /// By bytes.
        ByteLevel,
        /// Several in turn.
        Sequence,
        /// By a template.
        Template(template::TemplateProcessing),
    }

    /// Several in turn.
    pub mod sequence {
        /// Several in turn.
        pub struct Sequence;

        impl Sequence {
            /// Drops the steps.
            pub fn new(_steps: Vec<super::PostProcessorWrapper>) -> Sequence {
                Sequence
            }
        }
    }

    /// By a template.
    pub mod template {
        use crate::Missing;

        /// A template; there is none.
        #[derive(Clone)]
        pub enum TemplateProcessing {}

        impl TemplateProcessing {
            /// Returns a builder that makes none.
            pub fn builder() -> TemplateProcessingBuilder {
                TemplateProcessingBuilder
            }
        }

        /// A builder that makes nothing.
        pub struct TemplateProcessingBuilder;

        impl TemplateProcessingBuilder {
            /// Refused.
            pub fn try_single(self, _pieces: Vec<String>) -> Result<TemplateProcessingBuilder, Missing> {
                Err(Missing)
            }

            /// Refused.
            pub fn try_pair(self, _pieces: Vec<String>) -> Result<TemplateProcessingBuilder, Missing> {
                Err(Missing)
            }

            /// Drops the tokens.
            pub fn special_tokens(self, _tokens: Vec<(String, u32)>) -> TemplateProcessingBuilder {
                self
            }

            /// Refused.
            pub fn build(self) -> Result<TemplateProcessing, Missing> {
                Err(Missing)
            }
        }
    }

    impl From<byte_level::ByteLevel> for PostProcessorWrapper {
        fn from(_: byte_level::ByteLevel) -> PostProcessorWrapper {
            PostProcessorWrapper::ByteLevel
        }
    }

    impl From<sequence::Sequence> for PostProcessorWrapper {
        fn from(_: sequence::Sequence) -> PostProcessorWrapper {
            PostProcessorWrapper::Sequence
        }
    }
}

/// All steps together.
pub mod tokenizer {
    use crate::Missing;
    use crate::decoders::DecoderWrapper;
    use crate::models::bpe::BPE;
    use crate::normalizers::NormalizerWrapper;
    use crate::pre_tokenizers::PreTokenizerWrapper;
    use crate::processors::PostProcessorWrapper;

    /// What becomes of a text's separators.
    pub enum SplitDelimiterBehavior {
        /// Pieces of their own.
        Isolated,
    }

    /// A token beside the model's.
    pub struct AddedToken;

    impl AddedToken {
        /// Drops the token.
        pub fn from(_content: String, _special: bool) -> AddedToken {
            AddedToken
        }
    }

    /// A tokenizer; there is none, as there is no model.
    pub struct Tokenizer(BPE);

    impl Tokenizer {
        /// A model's tokenizer.
        pub fn new(model: BPE) -> Tokenizer {
            Tokenizer(model)
        }

        /// Never called.
        pub fn with_normalizer(&mut self, _: Option<NormalizerWrapper>) -> Result<&mut Tokenizer, Missing> {
            match self.0 {}
        }

        /// Never called.
        pub fn with_pre_tokenizer(&mut self, _: Option<PreTokenizerWrapper>) -> &mut Tokenizer {
            match self.0 {}
        }

        /// Never called.
        pub fn with_decoder(&mut self, _: Option<DecoderWrapper>) -> &mut Tokenizer {
            match self.0 {}
        }

        /// Never called.
        pub fn with_post_processor(&mut self, _: Option<PostProcessorWrapper>) -> &mut Tokenizer {
            match self.0 {}
        }

        /// Never called.
        pub fn add_special_tokens(&mut self, _: Vec<AddedToken>) -> Result<usize, Missing> {
            match self.0 {}
        }
    }
}

pub use tokenizer::{AddedToken, Tokenizer};
