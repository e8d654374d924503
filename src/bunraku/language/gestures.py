"""What people say with their hands, and do with small things, in canonical words: "folds his arms" is "cross arms".

Hardly any of it was ever captured; `synthetic.gestures` has key poses for each of them.
"""

from __future__ import annotations

__all__ = ["GESTURE_THINGS", "GESTURE_WORDS", "SWALLOWED"]

_OWN = r"(the |a |one |both |his |her |their |its )?(left |right )?"
_SOMEBODY = r"(somebody|someone|people|him|her|them|us|me)"

GESTURE_WORDS: dict[str, str] = {
    "look around": r"look(s|ing)? (around|about|left and right|right and left|from side to side|"
    r"(back |behind )?(over|across) (the |his |her |their |its )?(left |right )?shoulder)",
    "look far": rf"look(s|ing)? (far( away)?|into the distance)|(shad|shield)(es|ing) {_OWN}eyes",
    "kiss": r"kiss(es)?|kissing",
    "thumbs up": r"thumbs?[- ]up|thumb in approval",
    "stop": r"(hand|palm|arm)\b.* stop|say(s|ing)? stop|signal\w* ([a-z]+ )?stop|stop (gesture|sign)",
    "beckon": rf"beckon\w*|come here|(wav|call)(es|s|ing) {_SOMEBODY} (over|closer|nearer)",
    "facepalm": rf"face-?palm(s|ing)?|covers {_OWN}face with {_OWN}(palm|hand)|in despair",
    "hands on hips": rf"hands (on|at) {_OWN}hips|akimbo|superhero",
    "cross arms": rf"(cross|fold)(es|s|ed|ing)? {_OWN}arms|arms (crossed|folded)",
    "think": rf"think(s|ing)?|ponder\w*|contemplat\w*|(rub|strok)(s|es|ing) {_OWN}(chin|beard)|hand on {_OWN}chin",
    "cheer": r"cheer(s|ing)?|celebrat(es|ing)|rejoic(es|ing)|(hands|arms) in the air",
    "fist pump": rf"fist[- ]pumps?|pump(s|ing)? {_OWN}fists?",
    "surrender": rf"surrender\w*|put(s|ting)? {_OWN}hands up|hands up in",
    "shake hands": rf"shak(es?|ing) hands|shak(es?|ing) {_SOMEBODY}('s)? hand|handshakes?",
    "high five": r"high[- ]fives?",
    "hug": r"hug(s|ging)?|embrac(es|ing)",
    "listen": r"listen(s|ing)?|eavesdrop\w*",
    "dab": r"dab(s|bing)?",
    "text": rf"text(s|ing)|(typ|writ|send)(s|es|ing) a (text )?message|look(s|ing)? at {_OWN}phone",
    "photo": r"photos?|photograph\w*|takes? (a |some )?pictures?|taking (a |some )?pictures?|selfies?|snapshots?",
    "scratch": r"scratch(es|ing)?",
    "watch": rf"(checks?|looks? at|checking|looking at) {_OWN}(wrist ?)?watch",
    "guitar": r"guitars?|strum(s|ming)?",
    "piano": r"pianos?|plays? (a |the )?keyboard",
    "type": r"typ(es|ing)|works? at a computer|on a keyboard",
    "drums": r"drum(s|ming)?",
    "violin": r"violins?|play(s|ing)? the fiddle",
    "conduct": r"conduct(s|ing)?",
    "shiver": r"shiver\w*|trembl(es|ing)|freez(es|ing) in the cold",
    "yawn": r"yawn(s|ing)?",
    "cover ears": rf"(cover|hold|plug|clos|shut)(s|es|ing) {_OWN}ears",
    "cry": r"cr(ies|ying)|weep(s|ing)?|sob(s|bing)?|covers the face with both hands|hands over the face",
    "cough": r"cough(s|ing)?",
    "sneeze": r"sneez(es|ing)",
    "knock": r"knock(s|ing)? (on|at)|knock(s|ing)$",
    "open door": r"open(s|ing)? (a|the) (door|gate|window)",
    "write": r"writ(es|ing)|scribbl(es|ing)|takes notes",
    "read": r"reads|reading|read a",
    "brush teeth": rf"brush(es|ing)? {_OWN}teeth",
    "brush hair": rf"(brush|comb)(es|s|ing)? {_OWN}hair",
    "cast": r"spells?|magic|casts|casting|fireballs?",
    "flex": rf"flex(es|ing)|show(s|ing)? off {_OWN}muscles|bodybuilder",
    "rub hands": rf"rub(s|bing) {_OWN}hands|warm(s|ing) {_OWN}hands",
    "sing": r"sing(s|ing)?|karaoke|microphone",
    "rock": r"(rock|cradl)(s|es|ing) (a|the) baby|holds a baby",
    "wipe brow": rf"wip(es|ing) {_OWN}(sweat|brow|forehead)",
    "rub belly": rf"(rub|pat|strok)(s|es|bing|ting|ing) {_OWN}(belly|stomach|tummy)|stomach ?ache",
    "wave both": (
        r"wav(e|es|ing) ([a-z]+ )?(with )?(both|two) (of )?(the )?(hands|arms)|wav(e|es|ing) (the |his |her |their )?"
        r"arms"
    ),
    "both knees": r"(on|to) both knees",
    "propose": r"propos(es|ing)|holds out a ring",
    "box": (
        r"boxers?|boxing|shadow[- ]?box\w*|(?:^|person |man |woman |boy |girl |somebody |someone |he |she |and )boxe?s"
        r"( in| against| with| like|$)"
    ),
    "pitch": r"pitch(es|ing)? (a|the) (\w+ )?(ball|baseball|fastball|strike)|pitchers?",
    "bat": (
        r"(swing|swings|swinging) (a|the) (\w+ )?bat|with (a|the) (baseball )?bat|baseball bats?|plays? baseball|"
        r"playing baseball|bats a ball"
    ),
    "tennis": r"(?<!table )(?<!table-)tennis|rackets?|racquets?",
    "serve": r"serv(es?|ing)( a)?( the)?( in)? (tennis|ball|volleyball)|tennis serves?|tosses the ball up and serves",
    "march in place": (
        r"(march|walk|stepp?)(es|s|ing)? (slowly |quickly |fast )?(in place|on the spot)|marching steps in place|"
        r"marks time"
    ),
    "run in place": (
        r"(run|runs|running|jogs?|jogging|sprints?) (slowly |quickly |fast |lightly )?(in place|on the spot)"
    ),
    "zombie": r"zombies?|mummy|mummies|frankenstein|undead",
    "stumble": r"stumbl(e|es|ing)|(?<!ego )trip(s|ping)?( over)?|loses (the |his |her )?balance",
    "jump over": (
        r"(jump|leap|spring|bound|vault)(s|ing)? over|hurdl(e|es|ing)|over (a|an|the|some) (\w+ )?(hurdle|puddle|"
        r"obstacle|fence|log|gap|ditch)"
    ),
    "ladder": r"climb(s|ing)? (up )?(on |onto )?(a |the )?ladder|(?<!from )up (a |the )?ladder",
}  # fmt: skip
"""Canonical words with what stands for them."""

GESTURE_THINGS = (
    "goodbye searching everybody cups plate apple camera orchestra book page pot wrapped waking noise biceps club meal "
    "soldier boxer jabs cross hook overarm stone fastball baseball racket serve pitcher press fours puddle obstacle "
    "log abs freestyle newspaper soup spoon undead hair combs"
)
"""Other words of sentences that tell these gestures."""
_ALWAYS = frozenset({"idle", "raise arm", "talk", "twist", "put down", "reach", "stretch"})
_MORE: dict[str, set[str]] = {
    "stop": {"signal"}, "beckon": {"wave"}, "dab": {"dance"}, "fist pump": {"cheer"},
    "text": {"phone", "write", "type"}, "conduct": {"signal"}, "brush teeth": {"wash"}, "wipe brow": {"wash"},
    "brush hair": {"wash"}, "cast": {"throw"}, "wave both": {"wave"}, "box": {"punch", "throw", "block"},
    "pitch": {"throw", "baseball", "knee lift"}, "bat": {"baseball", "throw"}, "tennis": {"racket"},
    "serve": {"tennis", "racket", "throw"}, "march in place": {"march", "walk", "knee lift"},
    "run in place": {"run", "knee lift"}, "zombie": {"walk", "stagger", "march"}, "stumble": {"catch", "walk"},
    "jump over": {"jump", "run", "long jump", "knee lift", "sword"}, "ladder": {"climb", "walk"},
    "read": {"turn"}, "propose": {"kneel"}, "both knees": {"kneel"}, "facepalm": {"cry"}, "shake hands": {"shake head"},
}  # fmt: skip
SWALLOWED: dict[str, frozenset[str]] = {name: _ALWAYS | frozenset(_MORE.get(name, ())) for name in GESTURE_WORDS}
"""What a sentence that says a gesture says no more than that."""
