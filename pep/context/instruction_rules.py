"""Rules for texts that read like instructions to a model, each for a class of the literature.

Indirect prompt injection (Greshake et al. 2023, arXiv 2302.12173), HouYi's separator and disruptor components (Liu et
al. 2023, arXiv 2306.05499), the attacks of AgentDojo (Debenedetti et al. 2024, arXiv 2406.13352) and InjecAgent (Zhan
et al. 2024, arXiv 2403.02691), tool poisoning, forged chat markup and forged authority. The wordings are ours.

Every rule runs in linear time: no repetition stands inside another one, and every gap is bounded. They read folded text
(`capabilities.values.characters.folded`): lower case, one alphabet, nothing hidden. They err in both directions: a text
in another wording is not found here, and its label is what protects.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

_GAP: Final = r"[^.!?\n]{0,40}?\b"
"""Gap between two words of one order."""
_SPACE: Final = r"[\s*_]{1,8}"
"""Space in a rule: any white space, and the marks of emphasis."""
_BEGINS: Final = re.compile(
    r"(?:\A|[.!?:;\n>*\"'(\[-])[\s*_\"'(\[#>-]{0,8}"
    r"(?:(?:please|now|then|first|instead|also|and|so|just|bitte|jetzt|nun|dann|zuerst|also)[\s,*_]{1,8})?\Z"
)
"""End of the text before a sentence, with its markup and a word of courtesy."""
_NOT: Final = re.compile(r"\b(?:not|never|nor|cannot|can't|n't|without|nicht|nie|niemals|kein|keine)\b[^.!?\n]{0,32}\Z")
"""End of the text before an order that is forbidden and not given: manuals are full of these."""
_BACK: Final = 48
"""Characters before an order that are searched for a negation and for the sentence's beginning."""


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule.

    Attributes:
        name: of the class.
        cues: a text without any of these is not searched.
        pattern: on folded text.
        begins: whether it is an order only where a sentence begins.
        spared: whether a negation before it says that it is no order.
    """

    name: str
    cues: tuple[str, ...]
    pattern: re.Pattern[str]
    begins: bool = False
    spared: bool = False


def _rule(name: str, cues: str, *alternatives: str, begins: bool = False, spared: bool = False) -> Rule:
    spaced = "|".join(f"(?:{each})" for each in alternatives).replace(" ", _SPACE)
    return Rule(name, tuple(cues.split()), re.compile(spaced), begins, spared)


_ORDER: Final = (
    r"(?:instruction|direction|guideline|prompt|rule|order|command|message|context|constraint|task|polic(?:y|ie))s?\b"
)
_BEFORE: Final = (
    r"(?:previous|prior|above|preceding|earlier|initial|original|existing|former|foregoing|past|system|given)"
)
_DROP: Final = (
    r"\b(?:ignore|disregard|forget|override|discard|neglect|overlook|drop|do not (?:follow|obey)|stop following)"
)
_ANWEISUNG: Final = r"(?:anweisung|instruktion|regel|vorgabe|befehl|auftr[aä]g|richtlinie|prompt|nachricht)\w{0,3}\b"
_VORIGE: Final = r"(?:vorherig|bisherig|vorig|obig|fr[uü]her|vorangegangen|urspr[uü]nglich|bestehend|vorstehend)\w{0,2}"
_MODEL: Final = (
    r"(?:(?:ai )?(?:agent|assistant|planner)|ai (?:model|system)|ai|a\.i\.|llm|language model|chatbot|gpt|claude|"
    r"orchestrator|ki|ki-(?:agent|assistent|modell|system)\w{0,2}|assistent\w{0,2}|sprachmodell)"
)
_PERSON: Final = (
    r"(?:(?:the|any|your|this|den|dem|der|die) )?"
    r"(?:user|operator|human|person|people|anyone|supervisor|owner|bediener|benutzer|nutzer|menschen|niemandem)s?"
)
_GUARD: Final = (
    r"(?:approval|authori[sz]ation|permission|confirmation|guard-?rail|guard rail|safety (?:check|limit|rule|"
    r"polic(?:y|ie)|filter)|"
    r"security (?:check|polic(?:y|ie))|polic(?:y|ie) (?:check|engine)|restriction|speed limit|content filter)s?\b"
)
_SCHRANKE: Final = (
    r"(?:freigabe|genehmigung|zustimmung|best[aä]tigung|sicherheitspr[uü]fung|sicherheitsregel|richtlinie|"
    r"einschr[aä]nkung|geschwindigkeitsbegrenzung|beschr[aä]nkung)\w{0,2}\b"
)
_ALL: Final = r"(?:(?:the|all|any|every|your|further) )?(?:\w{1,16} )?"
_ALLE: Final = r"(?:die|alle|jede|s[aä]mtliche|deine) (?:\w{1,20} )?"
_ROLE: Final = (
    r"(?:an?|the|acting|operating|running|free|unrestricted|unbound|bound|limited|root|admin\w{0,9}|dan|"
    r"eine?|der|die|das|frei|unbeschr[aä]nkt|gebunden|befugt)\b"
)
_TOOL: Final = r"[`'\"]?[a-z0-9]{1,24}(?:_[a-z0-9]{1,24}){1,6}[`'\"]?"

RULES: Final = (
    _rule(
        "override",
        "ignor disregard forget overrid discard neglect overlook drop follow obey missacht verg verwirf 忽略",
        rf"{_DROP} {_GAP}{_BEFORE} {_GAP}{_ORDER}",
        rf"{_DROP} (?:all|any|every|everything|your|the|these|those) {_GAP}(?:instructions|orders|rules|prompt|"
        r"guidelines)\b",
        rf"{_DROP} (?:everything|all|anything)(?: (?:that|which))? (?:above|before|you (?:were|have been|are) told)\b",
        rf"\b(?:ignorier|missacht|vergiss|vergesse|verwirf)\w{{0,3}} {_GAP}(?:{_VORIGE}|alle|deine|die) "
        rf"{_GAP}{_ANWEISUNG}",
        rf"\bignore[rz]? {_GAP}instructions (?:pr[eé]c[eé]dentes|ant[eé]rieures)\b",
        rf"\bignora {_GAP}instrucciones (?:anteriores|previas)\b",
        r"忽略.{0,12}(?:指令|指示|说明)",
        spared=True,
    ),
    _rule(
        "new orders",
        "instruction order directive prompt your anweisung instruktion auftrag aufgabe",
        r"\b(?:new|updated|revised|real|actual|true|important|urgent) (?:system )?(?:instruction|order|directive|"
        r"prompt)s?"
        rf"(?:\s?:| follow\b| are\b| for (?:the )?{_MODEL}\b)",
        r"\byour (?:new|real|actual|true|only) (?:task|goal|objective|mission|purpose|job|instructions?) (?:is|are)\b",
        r"\b(?:neue|aktualisierte|wichtige|eigentliche) (?:system)?(?:anweisung|instruktion|auftrag)\w{0,2}"
        rf"(?:\s?:| f[uü]r (?:die|den|das) {_MODEL}\b)",
        r"\b(?:deine|ihre) (?:neue|eigentliche|wahre|einzige) aufgabe (?:ist|lautet)\b",
    ),
    _rule(
        "another role",
        "you from pretend mode bist sind sofort jetzt",
        rf"\byou are (?:now|no longer|from now on) {_ROLE}",
        r"\bfrom now on,? (?:you|always|never|act|respond|answer)\b",
        r"\bpretend (?:that you|to be|you are)\b",
        rf"\b(?:developer|debug|god|admin|maintenance|dan|jailbreak) mode (?:is (?:now )?)?(?:enabled|activated|"
        rf"on)\b{_GAP}you\b",
        rf"\b(?:du bist|sie sind) (?:jetzt|nun|ab (?:jetzt|sofort)|nicht (?:mehr|l[aä]nger)) {_ROLE}",
        r"\bab (?:jetzt|sofort) (?:antwortest|bist|handelst|folgst|ignorierst|verh[aä]ltst|f[uü]hrst|gehorchst) du\b",
    ),
    _rule(
        "to the model",
        "ai agent assist model llm gpt claude bot planner orchestrator ki",
        r"\b(?:attention|note|notice|message|instructions?|hint|memo|important|hinweis|achtung|nachricht|"
        rf"anweisung)[\s,:!-]{{1,4}}(?:to|for|an|f[uü]r) (?:(?:the|any|all|every|die|den|das|alle) )?{_MODEL}s?\b",
        r"\b(?:attention|achtung)[\s,:!]{1,3}(?:all )?(?:ai|llm|assistant|chatbot|language model|ki)s?\b",
        rf"\b(?:if|when) you are (?:an? |the )?{_MODEL}\b",
        rf"\bas (?:an? |the ){_MODEL},? you (?:must|should|shall|will|have to|need to|are required)\b",
        rf"\b(?:wenn|falls) du (?:eine? )?{_MODEL} bist\b",
        rf"\bals {_MODEL} (?:musst|sollst|darfst|wirst) du\b",
    ),
    _rule(
        "forged markup",
        "<| [ << < inst",
        r"<\|(?:im_start|im_end|system|user|assistant|endoftext|eot_id|start_header_id)\|?>?",
        r"\[/?inst\]|<</?sys>>|</?(?:system|system_prompt|system-reminder|assistant|instructions?)>",
    ),
    _rule(
        "concealment",
        "tell inform notify alert mention reveal show asking waiting "
        "knowledge secret hid keep sag erz meld verrat zeig ohne",
        r"\b(?:do not|don't|never|must not) (?:tell|inform|notify|alert|(?:mention|reveal|show) (?:this|it) to) "
        rf"{_PERSON}\b",
        rf"\bwithout (?:asking|telling|informing|notifying|alerting|the knowledge of|waiting for) {_PERSON}\b",
        rf"\b(?:keep|hide) (?:this|it) (?:secret |hidden )?from {_PERSON}\b",
        rf"\b(?:sage?|erz[aä]hle?|melde|verrate|zeige) (?:das |es |dies )?{_PERSON} (?:davon )?(?:nichts|nicht)\b",
        rf"\bohne {_PERSON} zu (?:fragen|informieren|benachrichtigen|warnen)\b",
    ),
    _rule(
        "prompt extraction",
        "prompt instruction token key credential anweisung instruktion zugang schl",
        rf"\b(?:reveal|print|repeat|output|show|display|leak|disclose|send|reproduce) {_GAP}(?:system prompt|"
        r"(?:initial|hidden|secret|original) (?:prompt|instructions)|your (?:prompt|instructions|token|private "
        r"key|credentials))\b",
        rf"\b(?:gib|zeige|wiederhole|nenne|verrate) {_GAP}(?:system-?prompt|deine (?:anweisungen|instruktionen|"
        r"zugangsdaten)|"
        r"dein(?:en)? (?:prompt|token|schl[uü]ssel))\b",
        spared=True,
    ),
    _rule(
        "forged authority",
        "approv author permi confirm grant sign consent overrid supersed precedence priority "
        "replac given cleared genehmigt freigegeben zugestimmt erlaubt best berechtigt befugt autorisiert erm",
        r"\b(?:operator|administrator|admin|supervisor|safety officer|sponsor|user|management) (?:has|have|had) "
        r"(?:already |explicitly |verbally |previously |just )(?:approved|authori[sz]ed|permitted|confirmed|"
        r"granted|signed off)\b",
        r"\b(?:approval|authori[sz]ation|permission|consent) (?:is|was|has been) (?:already |"
        r"automatically |pre-)"
        r"(?:granted|given|approved)\b",
        rf"\b(?:this|these) {_GAP}(?:overrides?|supersedes?|takes? (?:precedence|priority) over|replaces?) "
        rf"(?:all|any|every|your) {_GAP}{_ORDER}",
        r"\byou (?:are|have been) (?:hereby |now )?(?:authori[sz]ed|granted|given permission|cleared) to\b",
        rf"\b(?:bediener|administrator|sicherheitsbeauftragter?|vorgesetzter?|benutzer) hat {_GAP}(?:bereits|schon|"
        rf"ausdr[uü]cklich|m[uü]ndlich) {_GAP}(?:genehmigt|freigegeben|zugestimmt|erlaubt|best[aä]tigt)\b",
        rf"\bdu (?:bist|wurdest) {_GAP}(?:berechtigt|befugt|autorisiert|erm[aä]chtigt)\b",
    ),
    _rule(
        "around a guard",
        "bypass skip circumvent around evade umgeh springe",
        rf"\b(?:bypass|skip|circumvent|work around|evade) {_ALL}{_GUARD}",
        rf"\b(?:umgehe?|[uü]berspringe?) {_ALLE}{_SCHRANKE}",
        spared=True,
    ),
    _rule(
        "a call to make",
        "_ using calling answering doing responding",
        r"\b(?:before|after) (?:using|calling|answering|doing|responding)\b[^.!?\n]{0,40}?[\s,]{1,8}"
        r"(?:you (?:must|should|have to)|always|first) (?:call|read|send|move|pass|include|execute|run)\b",
    ),
    _rule(
        "another role",
        "act behave respond",
        r"\b(?:act|behave|respond) as (?:if you\b|(?:an?|the) (?:admin|root|unrestricted|system|"
        r"developer|operator|supervisor|jailbroken))",
        begins=True,
    ),
    _rule(
        "to the model",
        "ai agent assist model llm gpt claude bot planner orchestrator ki",
        rf"\b(?:dear |hey |hello |hallo |liebe\w? )?{_MODEL}s?(?: (?:please|ignore|execute|bitte|ignoriere)\b|"
        r"[,:-]\s{0,2}(?:you )?(?:must|should|please|now|ignore|execute|call|move|bitte|f[uü]hre|ignoriere)\b)",
        begins=True,
    ),
    _rule(
        "forged markup",
        "begin end start of system assistant developer human user",
        r"\b(?:begin|end|start of|end of) (?:system|user|admin(?:istrator)?|developer|new) "
        r"(?:prompt|message|instructions?|override)\b",
        r"\b(?:system|assistant|developer|human|user)\s{0,4}(?:\([^)\n]{0,24}\))?\s{0,2}:\s{0,4}"
        r"(?:you|ignore|disregard|please|execute|call|the (?:user|operator) (?:has|is|wants)|du|bitte)\b",
        begins=True,
    ),
    _rule(
        "around a guard",
        "ignor disable override off remove deaktivier entfern",
        rf"\b(?:ignore|disable|override|turn off|switch off|remove) {_ALL}{_GUARD}",
        rf"\b(?:ignoriere?|deaktiviere?|entferne?) {_ALLE}{_SCHRANKE}",
        begins=True,
        spared=True,
    ),
    _rule(
        "a call to make",
        "_",
        rf"\b(?:call|invoke|run|execute|trigger) (?:the )?{_TOOL} "
        r"(?:(?:tool|function) )?(?:with|using|now|immediately)\b",
        rf"\b(?:rufe?|f[uü]hre) (?:das (?:werkzeug|tool) )?{_TOOL} (?:mit|auf|aus|"
        r"und|sofort)\b",
        begins=True,
    ),
)

_SPACED: Final = re.compile(r"(?<![^\W_])\w(?:[ .\-_*|/]{1,3}\w(?![^\W_])){7,}")
"""Letters that stand alone, eight or more in a row: a word that is spelled out."""
_EMPHASIS: Final = re.compile(r"(?<![^\W_])_+|_+(?![^\W_])")
"""Underscores at the edge of a word, which emphasise it; inside a name they belong to it."""
_SEPARATORS: Final = re.compile(r"[ .\-_*|/]")
_SQUEEZED: Final = re.compile(
    r"ignore(?:all|any|the|your|every)?(?:previous|prior|above|instructions|rules|orders)|ignoreall|disregardall|"
    r"disregard(?:all|any|the|your)?(?:previous|prior|above|instructions|rules)|systemprompt|newinstructions|"
    r"ignoriere(?:alle|die)?(?:vorherigen|bisherigen|obigen|anweisungen)|youarenow|bypass(?:the)?(?:safety|approval)"
)


def matches(folded: str) -> Iterator[tuple[str, int]]:
    """The rules that a folded text breaks, each with the place of every match."""
    folded = _EMPHASIS.sub(lambda match: " " * len(match.group()), folded)
    for rule in RULES:
        if not any(cue in folded for cue in rule.cues):
            continue
        for match in rule.pattern.finditer(folded):
            before = folded[max(0, match.start() - _BACK) : match.start()]
            if (rule.begins and not _BEGINS.search(before)) or (rule.spared and _NOT.search(before)):
                continue
            yield rule.name, match.start()
    for match in _SPACED.finditer(folded):
        if _SQUEEZED.search(_SEPARATORS.sub("", match.group())):
            yield "spelled out", match.start()
