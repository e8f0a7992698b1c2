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

/// A function of these arguments, which drops them.
macro_rules! makes {
    ($made:ident, $($name:ident($($argument:ty),*)),+ $(,)?) => {
        impl $made {
            $(pub fn $name($(_: $argument),*) -> $made { $made })+
        }
    };
}

/// A builder of a type that nothing makes: `drops` are dropped, `refuses` and `build` end in an error.
macro_rules! builds {
    ($built:ident, $builder:ident, drops: $($drop:ident($dropped:ty)),*; refuses: $($refuse:ident($refused:ty)),*) => {
        impl $built {
            pub fn builder() -> $builder { $builder }
        }
        pub struct $builder;
        impl $builder {
            $(pub fn $drop(self, _: $dropped) -> $builder { self })*
            $(pub fn $refuse(self, _: $refused) -> Result<$builder, crate::Missing> { Err(crate::Missing) })*
            pub fn build(self) -> Result<$built, crate::Missing> { Err(crate::Missing) }
        }
    };
}

/// Conversions into a type that stands for any of several.
macro_rules! wraps {
    ($any:ident, $($one:ty => $made:expr),+) => {
        $(impl From<$one> for $any { fn from(_: $one) -> $any { $made } })+
    };
}

pub mod models {
    pub mod bpe {
        pub type Vocab = std::collections::HashMap<String, u32>;
        pub type Merges = Vec<(String, String)>;
        pub enum BPE {}
        builds!(BPE, BpeBuilder, drops: unk_token(String), byte_fallback(bool), ignore_merges(bool); refuses:);

        impl BpeBuilder {
            pub fn vocab_and_merges(self, _: Vocab, _: Merges) -> BpeBuilder {
                self
            }
        }
    }
}

pub mod normalizers {
    pub struct NormalizerWrapper;
    pub mod unicode {
        pub struct NFC;
    }
    wraps!(NormalizerWrapper, unicode::NFC => NormalizerWrapper);
}

pub mod pre_tokenizers {
    pub struct PreTokenizerWrapper;
    pub mod byte_level {
        #[derive(Default)]
        pub struct ByteLevel;
        makes!(ByteLevel, new(bool, bool, bool));
    }
    pub mod sequence {
        pub struct Sequence;
        makes!(Sequence, new(Vec<super::PreTokenizerWrapper>));
    }
    pub mod split {
        pub enum SplitPattern {
            Regex(String),
        }
        pub enum Split {}
        impl Split {
            pub fn new(
                _: SplitPattern,
                _: crate::tokenizer::SplitDelimiterBehavior,
                _: bool,
            ) -> Result<Split, crate::Missing> {
                Err(crate::Missing)
            }
        }
    }
    wraps!(
        PreTokenizerWrapper,
        byte_level::ByteLevel => PreTokenizerWrapper,
        sequence::Sequence => PreTokenizerWrapper,
        split::Split => PreTokenizerWrapper
    );
}

pub mod decoders {
    pub use crate::pre_tokenizers::byte_level;
    pub struct DecoderWrapper;
    wraps!(DecoderWrapper, byte_level::ByteLevel => DecoderWrapper);
}

pub mod processors {
    pub use crate::pre_tokenizers::byte_level;
    #[derive(Clone)]
    pub enum PostProcessorWrapper {
        ByteLevel,
        Sequence,
        Template(template::TemplateProcessing),
    }
    pub mod sequence {
        pub struct Sequence;
        makes!(Sequence, new(Vec<super::PostProcessorWrapper>));
    }
    pub mod template {
        #[derive(Clone)]
        pub enum TemplateProcessing {}
        builds!(
            TemplateProcessing, TemplateProcessingBuilder, drops: special_tokens(Vec<(String, u32)>);
            refuses: try_single(Vec<String>), try_pair(Vec<String>)
        );
    }
    wraps!(
        PostProcessorWrapper,
        byte_level::ByteLevel => PostProcessorWrapper::ByteLevel,
        sequence::Sequence => PostProcessorWrapper::Sequence
    );
}

pub mod tokenizer {
    use crate::{Missing, decoders, normalizers, pre_tokenizers, processors};

    pub enum SplitDelimiterBehavior {
        Isolated,
    }
    pub struct AddedToken;
    makes!(AddedToken, from(String, bool));

    /// There is none, as there is no model: no method is ever called.
    pub struct Tokenizer(crate::models::bpe::BPE);

    macro_rules! never {
        ($($name:ident($argument:ty) -> $made:ty),+ $(,)?) => {
            impl Tokenizer {
                $(pub fn $name(&mut self, _: $argument) -> $made { match self.0 {} })+
            }
        };
    }
    never!(
        with_normalizer(Option<normalizers::NormalizerWrapper>) -> Result<&mut Tokenizer, Missing>,
        with_pre_tokenizer(Option<pre_tokenizers::PreTokenizerWrapper>) -> &mut Tokenizer,
        with_decoder(Option<decoders::DecoderWrapper>) -> &mut Tokenizer,
        with_post_processor(Option<processors::PostProcessorWrapper>) -> &mut Tokenizer,
        add_special_tokens(Vec<AddedToken>) -> Result<usize, Missing>,
    );

    impl Tokenizer {
        pub fn new(model: crate::models::bpe::BPE) -> Tokenizer {
            Tokenizer(model)
        }
    }
}

pub use tokenizer::{AddedToken, Tokenizer};
