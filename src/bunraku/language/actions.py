"""What a sentence says that somebody does, in canonical words: "someone strolls off, then sits down" does "walk" and
"sit".

The training data are balanced by these words, reports list them, and the action test counts them.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence

from bunraku.language.gestures import GESTURE_WORDS, SWALLOWED

__all__ = ["ACTIONS", "CYCLIC", "actions_of", "main_actions", "says_any"]

ACTIONS: dict[str, str] = GESTURE_WORDS | {
    "jumping jack": r"jumping jacks?|star jumps?",
    "cartwheel": r"cartwheels?",
    "handstand": r"handstands?|walk\w* on (the )?hands|stands? on (the )?head|headstand",
    "flip": r"back ?flips?|front ?flips?|somersaults?|flic.?flac|handsprings?|flips? (over|backward|forward)",
    "roll": r"rolls? (over|forward|backward|on|across|sideways|to)|forward roll|backward roll|\brolls?$",
    "push-up": r"push-?ups?|press-?ups",
    "sit-up": r"sit-?ups?|crunch(es)?",
    "lunge": r"lunges?|lunging",
    "squat": r"squats?|squatting|knee bends?|crouch\w* (deep|down)|deep crouch",
    "jump rope": r"(jump|skip)\w* rope|rope skipping",
    "long jump": r"(long|broad|running) jumps?",
    "hop": r"hops?|hopping|hopscotch",
    "skip": r"skips?|skipping|gallop\w*",
    "jump": r"jumps?|jumping|leaps?|leaping|bounces?|bouncing|bounds?|bounding",
    "kick": r"kicks?|kicking",
    "knee lift": (
        r"knee (lifts?|raises?|to elbow)|(lifts?|raises?|lifting|raising) (the |each |one |a )?(left |"
        r"right )?knees?|high knees|knees high"
    ),
    "punch": r"punch\w*|jabs?|jabbing|uppercuts?|hooks?|spar(s|ring)?|hits? out",
    "block": r"blocks?|blocking|dodg\w*|ducks?|ducking|parr(y|ies)|evad\w*|guard stance",
    "sword": r"swords?|slash\w*|stab\w*|spear|axe|chops?|chopping|fenc\w*|shield",
    "shoot": (
        r"(aims?|aiming|shoots?|shooting|fires?|firing|point\w*) (a |the |with a )?(gun|pistol|rifle|bow|crossbow|"
        r"arrow)|pistol|rifle|archer\w*|arrows?|crossbow|(draw\w*|aim\w*|shoot\w*|rais\w+|lower\w*|hold\w*|with|lifts?)"
        r" (a |the )?(drawn )?bow\b"
    ),
    "dribble": r"dribbl\w*|bounc\w+ (a|the) (basket)?ball",
    "shoot a ball": (
        r"(jump |shoot\w* |throw\w* )?(a |the )?(basketball|basket|jump shot|free throw|lay-?up)s?|shoots?( a|"
        r" the)? ball|jump shots?"
    ),
    "racket": (
        r"tennis|racket|paddle|ping-?pong|table tennis|forehand|backhand|strokes?|serves?|swat\w*|rally|rallies"
    ),
    "golf": r"golf\w*|putts?|putting",
    "baseball": r"baseball|bats?\b|pitch(es|ing)?",
    "soccer": r"soccer|football",
    "throw": r"throw\w*|toss\w*|pitch(es|ing)? a|hurl\w*|lobs?",
    "catch": r"catch\w*",
    "wave": r"wav(e|es|ing)\b(?! (legs|hips))",
    "clap": r"claps?|clapping|applaud\w*",
    "nod": r"nods?|nodding",
    "shake head": r"shak\w+ (the |its |his |her )?head|head ?shak\w*|says? no",
    "bow": (
        r"(?<!draw )(?<!with )(?<!drawn )(?<!aim )(?<!with a )(?<!draws a )bows?( deeply| politely| down| forward)?$|"
        r"bowing|(deep|polite|low|slight) bow\b|tak(es|ing)? a bow|curts\w*|"
        r"bows (deeply|down|forward|politely|to|with|and|low)"
    ),
    "salute": r"salut\w*",
    "point": r"points?|pointing",
    "signal": r"signals?|signall?ing|referee|directs? traffic",
    "shrug": r"shrugs?|shrugging",
    "pray": r"pray\w*|medit\w*",
    "drink": r"drink\w*|sips?|sipping",
    "eat": r"eats?|eating|chew\w*|(has|having) (a meal|lunch|dinner|breakfast)|food to the mouth",
    "phone": r"phones?|phoning|telephon\w*",
    "wash": (
        r"wash\w*|wip(e|es|ing)|polish\w*|mop\w*|sweep\w*|broom|scrub\w*|clean\w*|brush\w*|vacuum\w*|rak(es|ing)|"
        r"shovel\w*|dig(s|ging)?|paint(s|ing)?\b|hammer\w*|saw(s|ing)?"
    ),
    "cook": r"cook\w*|stir\w*|chef|knead\w*|pour\w*|unscrew\w*",
    "pick up": (
        r"pick\w* (something|it|up|an? |the |things)|pick\w*-?up|grabs? something|lift\w* (something|a box|"
        r"an object|a heavy)|stoop\w*|reach\w* (down )?(to|for|toward) the (floor|ground)"
    ),
    "put down": (
        r"put\w* (something|it|an?|the \w+) (down|on|onto|back)|set\w* (something|it) down|deposit\w*|plac(es|"
        r"ing) something"
    ),
    "carry": r"carr(y|ies|ying)|hold\w* a (heavy|box)",
    "push": r"push(es|ing)?(?!-?up)|shov(e|es|ing)",
    "pull": r"pulls?|pulling|tugs?|drags?|dragging",
    "reach": r"reach\w*|grab\w*|grasp\w*",
    "raise arm": (
        r"(raises?|raising|lifts?|lifting|puts?|holds?|stretch\w*) (up )?(the |both |one |an? |his |her |"
        r"each )?(left |right )?(arms?|hands?)( up| high| overhead| forward| out| above)?|arms? (up|raised|"
        r"overhead|out|wide)|hands? up"
    ),
    "arm circle": (
        r"arm circles?|circl\w+ (with )?(the |both |one )?(left |right )?arms?|(rotat|swing|windmill)\w* (the |"
        r"both )?(left |right )?arms?|windmills?|swim strokes? with|arms? in (big |wide |small )?circles"
    ),
    "stretch": (
        r"stretch\w*|bend(s|ing)? (sideways|to the side|to each side)|side bends?|toe touch\w*|"
        r"touch\w* (the )?toes|yoga|warms? up|limber\w*"
    ),
    "twist": r"twists?|twisting|trunk|waist|hips?",
    "climb": r"climb\w*|ladder|scrambl\w*|steps? up on(to)?|stairs?|steps? (over|onto)",
    "hang": r"hang\w*|monkey bars?|pull-?ups?|swings? (on|from)",
    "crawl": r"crawl\w*|on (all fours|hands and knees)|creep(s|ing)? on",
    "breaststroke": r"breast-?strokes?",
    "swim": r"swim\w*|freestyle|crawl stroke|diving",
    "fly": r"fl(y|ies|ying)\b|levitat\w*|hover\w*|float\w*",
    "sit": r"sits?|sitting|seated|takes? a seat",
    "stand up": r"stands? (back )?up|gets? (back )?up|ris(e|es|ing)( up)?|standing up|getting up|straighten\w* up",
    "kneel": r"kneel\w*|(on|to) (one|the left|the right|both) knees?|takes a knee",
    "lie": r"lies?|lying|sleep\w*|laid",
    "fall": r"falls?|falling|collaps\w*|knocked|tumbl\w*|drops? (dead|to)",
    "stagger": (
        r"stagger\w*|drunk\w*|dizz\w*|wobbl\w*|lurch\w*|totter\w*|off balance|pushed|shoved|recoil\w*"
    ),
    "limp": r"limp\w*|hobbl\w*|injured|hurt (leg|foot)",
    "imitate": (
        r"monster|ghost|gorilla|ape|monkey|dinosaur|chicken|bear|elephant|cat\b|robot"
    ),
    "sneak": r"sneak\w*|tiptoe\w*|prowl\w*|stealth\w*|creep\w*|on tiptoes?|stalk\w*",
    "march": r"march\w*|goose-?step\w*|parade",
    "salsa": r"salsa|cha-?cha|mambo",
    "ballet": r"ballet|pirouett\w*|jet[eé]s?|arabesque|pli[eé]|attitude|rond de",
    "dance": (
        r"danc\w*|charleston|moonwalk|breakdanc\w*|hip.?hop|rumba|waltz|macarena|groov\w*|lambada"
    ),
    "backward": (
        r"(walk|step|run|jog|mov|hop|jump|march|shuffl|back)\w* (slowly |quickly |a few steps |one step |"
        r"one pace )?(backwards?|back\b)|backs? (up|away)|backwards?"
    ),
    "sidestep": (
        r"side-?steps?|sidestep\w*|(step|shuffl|walk|mov|slid|strafe)\w* (to the (left|right|side)|sideways|left|"
        r"right|to one side)|sideways|crossover steps?|grapevine|strafe\w*"
    ),
    "spin": r"spin\w*|twirl\w*|whirl\w*|turns? (all the way|several times|once) around|full turns?|pivot\w*",
    "circle": (
        r"(in|around|round) (a |the )?(big |small |wide |tight |large |full )*circles?|circles? (around|to the|"
        r"left|right)|circling|figure eight|loop(s|ing)?\b"
    ),
    "turn around": (
        r"turn\w* (half ?way )?(around|round|back)|about.?face|half turns?|180|u-?turn|turn\w* and (walk|run|come|"
        r"go)\w* back|there and back|faces? the other way"
    ),
    "turn": r"turns?|turning|veer\w*|curv(e|es|ing)|swerv\w*|corner|rotat\w*|swings? around",
    "run": r"runs?|running|jogs?|jogging|sprint\w*|dash\w*|rac(es|ing)\b",
    "walk": (
        r"walk\w*|stroll\w*|strid\w*|strut\w*|stomp\w*|trudg\w*|shuffl\w*|wander\w*|paces?\b|pacing|steps?|"
        r"stepping|saunter\w*|ambl\w*|swagger\w*|struts?|tread\w*|moves? (around|forward|ahead)|goes"
    ),
    "idle": (
        r"idles?|stands? (still|idle|quietly|waiting|ready|calmly|in place|there|around|upright)|waits?|waiting|"
        r"stay\w* (still|put)|rest(s|ing)?|standing|stands?|pos(e|es|ing)|holds? still"
    ),
    "talk": (
        r"talk\w*|gestur\w*|explain\w*|argu\w*|speak\w*|chat\w*|story|tells?|convers\w*|greet\w*|hand signals?|"
        r"laugh\w*"
    ),
}  # fmt: skip
"""Canonical words with what stands for them, the more special first: "jumping jacks" are no jumps."""

CYCLIC = frozenset({
    "walk", "run", "march", "sneak", "limp", "zombie", "imitate", "skip", "hop", "jumping jack", "jump rope", "wave",
    "clap", "nod", "shake head", "punch", "dribble", "swim", "breaststroke", "crawl", "dance", "salsa", "idle",
    "arm circle", "spin", "circle", "sidestep", "backward", "wash", "cook", "twist", "knee lift", "push-up", "sit-up",
    "squat", "climb", "hang", "fly", "stagger", "talk", "racket", "carry", "pray", "lie", "sit", "eat", "drink",
    "phone", "march in place", "run in place", "wave both", "box", "tennis",
})  # fmt: skip
"""Actions that are still the same when they are done again."""

_SWALLOWS = {
    "jumping jack": {"jump"},
    "jump rope": {"jump", "skip"},
    "long jump": {"jump", "run", "idle"},
    "push-up": {"push"},
    "sit-up": {"sit", "lie"},
    "turn around": {"turn", "circle"},
    "spin": {"turn", "turn around"},
    "circle": {"turn", "turn around"},
    "backward": {"walk", "turn around"},
    "sidestep": {"walk"},
    "arm circle": {"circle", "raise arm", "turn"},
    "shake head": {"turn"},
    "shoot a ball": {"jump", "throw"},
    "handstand": {"idle"},
    "stand up": {"idle"},
    "knee lift": {"raise arm", "kneel"},
    "imitate": {"walk"},
    "march": {"walk"},
    "sneak": {"walk"},
    "limp": {"walk"},
    "stagger": {"walk", "stumble"},
    "fall": {"stumble"},
    "punch": {"throw"},
    "skip": {"hop", "jump"},
    "breaststroke": {"swim"},
    "swim": {"crawl"},
    "kneel": {"idle"},
    "flip": {"turn around", "turn"},
    "salsa": {"dance"},
    "ballet": {"dance"},
    "pick up": {"reach", "idle"},
    "catch": {"reach"},
    "lunge": {"walk"},
    "squat": {"idle"},
    "bow": {"idle"},
    "dribble": {"shoot a ball", "jump"},
    "phone": {"talk"},
    "stretch": {"raise arm"},
    **SWALLOWED,
}  # fmt: skip


@functools.cache
def _pattern(action: str) -> re.Pattern[str]:
    pattern = ACTIONS[action]
    return re.compile(rf"\b(?:{pattern})\b" if "$" not in pattern else rf"\b(?:{pattern})", re.IGNORECASE)


@functools.cache
def _beginnings(action: str) -> frozenset[str]:
    """The first three letters of all words of a pattern: a sentence without any of them does not match."""
    return frozenset(word[:3] for word in re.findall(r"[a-z]{2,}", re.sub(r"\\\w", " ", ACTIONS[action])))


def says_any(sentence: str) -> bool:
    """Whether a sentence says anything known, as `actions_of`."""
    plain = sentence.lower()
    return any(_found(action, sentence, plain) is not None for action in ACTIONS)


def _found(action: str, sentence: str, plain: str) -> re.Match[str] | None:
    """Where a sentence, in small letters too, says an action. Making all patterns takes 60 ms, so only those are made
    that may match.
    """
    if not any(letters in plain for letters in _beginnings(action)):
        return None
    return _pattern(action).search(sentence)


@functools.lru_cache(maxsize=65536)
def actions_of(sentence: str) -> tuple[str, ...]:
    """Canonical words of a sentence in the order in which it says them; none where it says nothing known."""
    found, plain = {}, sentence.lower()
    for action in ACTIONS:
        match = _found(action, sentence, plain)
        if match:
            found[action] = match.start()
    for action in list(found):
        for less in _SWALLOWS.get(action, ()):
            found.pop(less, None)
    return tuple(sorted(found, key=lambda action: found[action]))


def main_actions(texts: Sequence[str]) -> tuple[str, ...]:
    """What the sentences of one stretch agree on: the words of the tersest that says any, or, where none does,
    "other".
    """
    for text in reversed(texts):
        found = actions_of(text)
        if found:
            return found
    return ("other",)
