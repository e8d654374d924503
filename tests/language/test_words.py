"""Words of other languages: the table and the tagger."""

import re

import numpy as np
import pytest

from bunraku.core.files import PACKAGE_WEIGHTS
from bunraku.language import foreign_tagger
from bunraku.language.foreign_tagger import load_tagger, tagged, units
from bunraku.language.foreign_words import scan_spaced
from bunraku.language.lexicon import actions_of
from bunraku.language.parse import parse
from bunraku.language.translation import english_sentence, translate
from bunraku.language.vocabulary import says_action, stem
from bunraku.language.word_table import Concept, table

GERMAN = {
    "Eine Person geht nach vorne.": "a person walks forward",
    "Ein Mann geht langsam nach vorne, dann winkt er mit der linken Hand.": (
        "a man walks forward slowly, then waves with the left hand"
    ),
    "Die Person hebt beide Arme und springt zweimal hoch.": "a person raises both arms and jumps up twice",
    "Sie setzt sich auf einen Stuhl": "a person sits down on a chair",
    "steht auf und verbeugt sich": "a person stands up and bows",
    "Er dreht sich um 90 Grad nach links.": "a person turns left 90 degrees",
    "dreht sich um": "a person turns around",
    "Ein Hund läuft schnell im Kreis": "a dog runs in a circle quickly",
    "macht drei Schritte nach hinten": "a person takes three steps backward",
    "schüttelt den Kopf": "a person shakes the head",
    "den Kopf schütteln": "a person shakes the head",
    "Während er läuft, winkt er mit der rechten Hand": "a person waves with the right hand while running",
    "Er hebt den linken und den rechten Arm": "a person raises both arms",
    "tritt mit dem rechten Fuß": "a person kicks with the right foot",
    "Bevor er springt, geht er in die Hocke": "a person crouches, then jumps",
    "hüpft auf einem Bein": "a person hops on one leg",
    "Ein alter Mann geht zum Stuhl und setzt sich": "an old man walks to the chair and sits down",
    "laeuft nach links, dann nach rechts": "a person runs to the left, then to the right",
    "hebt die Kiste auf": "a person picks up a box",
    "aufstehen, umdrehen und weglaufen": "a person stands up, turns around and goes away",
    "der Drache fliegt hoch und landet auf dem Boden": "a dragon flies up and lands on the ground",
    "Sie läuft geradeaus und biegt dann nach rechts ab": "a person runs forward, then turns right",
    "wirft einen Ball mit der rechten Hand": "a person throws a ball with the right hand",
}
FRENCH = {
    "une personne marche": "a person walks",
    "Un homme marche vers l'avant puis salue de la main gauche.": "a man walks forward, then waves with the left hand",
    "elle lève le bras droit": "a person raises the right arm",
    "elle se lève": "a person stands up",
    "il tourne à gauche et court vite": "a person turns left and runs quickly",
    "saute deux fois": "a person jumps twice",
    "s’assoit sur une chaise, puis se lève": "a person sits down on a chair, then stands up",
    "la personne marche en levant les bras": "a person walks while raising the arms",
    "donne un coup de pied du pied droit": "a person kicks with the right foot",
    "un chien court en rond": "a dog runs in a circle",
    "fait trois pas en arrière": "a person takes three steps backward",
    "hoche la tête": "a person nods",
    "secoue la tête": "a person shakes the head",
    "s'agenouille et prie": "a person kneels down and prays",
    "applaudit trois fois": "a person claps the hands three times",
    "fait la roue": "a person does a cartwheel",
    "une vieille femme marche lentement": "an old woman walks slowly",
    "il lève les deux bras puis les baisse": "a person raises both arms, then lowers the arms",
    "avant de sauter, il s'accroupit": "a person crouches, then jumps",
    "marche comme un zombie": "a person walks like a zombie",
    "Un enfant marche à quatre pattes.": "a child crawls",
    "Assieds-toi et attends": "a person sits down and waits",
    "sauter, courir et tomber": "a person jumps, runs and falls down",
    "lance une balle avec la main droite": "a person throws a ball with the right hand",
}
SPANISH = {
    "una persona camina": "a person walks",
    "Camina hacia adelante y luego saluda con la mano izquierda.": (
        "a person walks forward, then waves with the left hand"
    ),
    "un hombre corre rápido en círculo": "a man runs in a circle quickly",
    "levanta los dos brazos": "a person raises both arms",
    "se levanta y camina": "a person stands up and walks",
    "levántate y salta": "a person stands up and jumps",
    "se sienta en una silla": "a person sits down on a chair",
    "da tres pasos hacia atrás": "a person takes three steps backward",
    "salta dos veces": "a person jumps twice",
    "gira a la derecha": "a person turns right",
    "la mujer baila salsa": "a woman dances salsa",
    "patea con el pie derecho": "a person kicks with the right foot",
    "camina agitando los brazos": "a person walks while shaking the arms",
    "se agacha lentamente": "a person crouches slowly",
    "mientras camina, saluda con la mano": "a person waves while walking",
    "lanza una pelota": "a person throws a ball",
    "antes de saltar, se agacha": "a person crouches, then jumps",
    "baila como un robot": "a person dances like a robot",
    "se acuesta en el suelo": "a person lies down on the ground",
    "niega con la cabeza": "a person shakes the head",
    "Levanta el brazo izquierdo y luego el derecho": "a person raises the left arm, then raises the right arm",
    "camina de puntillas hacia la izquierda": "a person tiptoes to the left",
    "un hombre viejo camina despacio": "an old man walks slowly",
    "caminar, sentarse y levantarse": "a person walks, sits down and stands up",
}
JAPANESE = {
    "歩く": "a person walks",
    "ゆっくり前に歩く": "a person walks forward slowly",
    "左手を振る": "a person waves with the left hand",
    "走ってからジャンプする": "a person runs, then jumps",
    "男の人が歩きながら手を振っています。": "a man waves while walking",
    "右足でボールを蹴る": "a person kicks a ball with the right foot",
    "両手を上げる": "a person raises both hands",
    "二回ジャンプして座る": "a person jumps twice, then sits down",
    "３回ジャンプします": "a person jumps three times",
    "犬が速く走る": "a dog runs quickly",
    "後ろに三歩下がる": "a person takes three steps back",
    "椅子に座って、立ち上がる": "a person sits down on a chair, then stands up",
    "左に曲がる": "a person turns left",
    "拍手してください": "a person claps the hands",
    "お辞儀をする": "a person bows",
    "首を横に振る": "a person shakes the head",
    "座る前に手を振る": "a person waves, then sits down",
    "ゾンビのように歩く": "a person walks like a zombie",
    "片足で立つ": "a person stands on one leg",
    "右へ二歩歩いて、左足で蹴る": "a person walks two steps to the right, then kicks with the left foot",
    "前に走って、止まって、振り返る": "a person runs forward, then stops, then turns around",
    "水を飲んだ": "a person drinks water",
}
CHINESE = {
    "走路": "a person walks",
    "他向前走三步，然后用左手挥手。": "a person walks three steps forward, then waves with the left hand",
    "一个女人在跳舞": "a woman dances",
    "向左转，然后跑步": "a person turns left, then runs",
    "举起双手": "a person raises both hands",
    "跳两次": "a person jumps twice",
    "慢慢地坐下": "a person sits down slowly",
    "踢右腿": "a person kicks with the right leg",
    "边走边挥手": "a person walks while waving",
    "一边跑一边鼓掌": "a person runs while clapping the hands",
    "一只狗在快速奔跑": "a dog runs quickly",
    "后退三步": "a person takes three steps back",
    "点点头": "a person nods",
    "从椅子上站起来": "a person stands up from a chair",
    "像僵尸一样走路": "a person walks like a zombie",
    "转身跑开": "a person turns around, then runs away",
    "用右手扔球": "a person throws a ball with the right hand",
    "坐下之前挥手": "a person waves, then sits down",
    "原地转圈": "a person spins in place",
    "单脚跳五下": "a person hops five times",
    "弯腰捡起一个箱子": "a person stoops, then picks up a box",
    "跑步时挥手": "a person waves while running",
    "士兵敬礼后转身": "a soldier salutes, then turns around",
    "挥了挥手": "a person waves",
}
ALL = {"de": GERMAN, "fr": FRENCH, "es": SPANISH, "ja": JAPANESE, "zh": CHINESE}


@pytest.mark.parametrize(
    ("language", "sentence", "english"),
    [(language, *pair) for language, pairs in ALL.items() for pair in pairs.items()],
)
def test_sentences_become_english(language, sentence, english):
    found = translate(sentence)
    assert (found.language, found.english, found.unknown) == (language, english, ())


def test_what_the_table_does_not_have_is_named():
    found = translate("Der Kobold läuft begeistert nach links")
    assert found.unknown == ("Kobold", "begeistert") and found.english == "a person runs to the left"
    found = translate("他在草原上奔跑")
    assert found.english == "a person runs" and "".join(found.unknown) == "草原"
    (word,) = (concept for concept in found.concepts if concept.kind == "unknown")
    assert "他在草原上奔跑"[word.start : word.stop] == "草原"


@pytest.mark.parametrize(
    "sentence",
    ["a person walks", "salsa", "die slowly", "hands up", "a man in a box", "turns left, then sits", "T-pose", ""],
)
def test_english_stays_as_it_is(sentence):
    assert translate(sentence).english == sentence and translate(sentence).language == "en"


def test_other_scripts_are_no_language_of_the_table():
    assert translate("человек идёт").language == "" and translate("사람이 걷는다").language == ""


def test_the_table_is_whole():
    rows = table()["verbs"]
    assert len(rows) >= 300 and len({row["en"] for row in rows}) == len(rows)
    for section, count in (("parts", 15), ("directions", 15), ("manners", 20), ("numbers", 10), ("beings", 30)):
        assert len(table()[section]) >= count
    for language in ALL:
        assert sum(language in row for row in rows) >= 300
    for row in rows:
        assert len(re.findall(r"\{[a-z]+\}", row["en"])) == 1, row["en"]


def test_most_verbs_of_the_table_are_ones_that_training_shows():
    known = [row["en"] for row in table()["verbs"] if says_action(re.sub(r"[{}<>]", "", row["en"]))]
    assert len(known) >= 290
    assert stem("waving") == stem("waves") == stem("waved") == stem("wave") != stem("walk")


@pytest.mark.parametrize("language", ALL)
def test_the_sides_and_the_order_are_kept(language):
    """Left for right in the sentence is left for right in English, and nothing else changes."""
    swaps = {
        "de": ("winkt mit der {} Hand, dann tritt er mit dem {} Fuß", ("linken", "rechten")),
        "fr": ("salue de la main {}, puis donne un coup de pied du pied {}", ("gauche", "droit")),
        "es": ("saluda con la mano {}, luego patea con el pie {}", ("izquierda", "derecho")),
        "ja": ("{}手を振って、{}足で蹴る", ("左", "右")),
        "zh": ("用{}手挥手，然后踢{}腿", ("左", "右")),
    }
    text, (left, right) = swaps[language]
    for sides, words in (((left, right), ("left", "right")), ((right, left), ("right", "left"))):
        english = translate(text.format(*sides)).english
        assert re.findall("left|right", english) == list(words), english
        assert english.index("wave") < english.index("kick")


def test_units_are_the_words_of_a_sentence_and_the_signs_of_one_without_spaces():
    text = "L'homme s’élance, 2 fois !"
    assert [text[unit.start : unit.stop] for unit in units(text, "fr")] == ["L'", "homme", "s’", "élance", "fois"]
    text = "人が、3回 跳ねる。"
    assert "".join(text[unit.start : unit.stop] for unit in units(text, "ja")) == "人が3回跳ねる"
    assert units("Füße", "de")[0].pieces == units("füsse", "de")[0].pieces != units("fusse", "fr")[0].pieces


def test_each_movement_of_the_network_is_one_action_in_english():
    network = load_tagger()
    assert len(network.config.verbs) >= 50
    for verb in network.config.verbs:
        assert len(actions_of(english_sentence([Concept("verb", verb, 0, 1)], "de"))) == 1, verb


def test_what_a_word_says_depends_on_what_stands_beside_it():
    network = load_tagger()
    alone = network(units("Person", "de"), "de")[0]
    beside = network(units("Person tanzt", "de"), "de")[0]
    assert alone.shape == (len(network.config.verbs),) and not np.allclose(alone, beside)
    assert ((alone >= 0) & (alone <= 1)).all()


class Sure:
    """A network that knows two words."""

    config = foreign_tagger.TaggerConfig(verbs=("{wave}", "{kick}"))

    def __init__(self, text, **known):
        self.text, self.known = text, known

    def __call__(self, found, language):
        verbs = self.config.verbs
        words = [self.text[unit.start : unit.stop] for unit in found]
        return np.array([[0.9 * (self.known.get(word) == verb) for verb in verbs] for word in words])


@pytest.mark.parametrize(
    ("text", "english"),
    [
        (
            "Eine Person wuppert zweimal mit der linken Hand und bulxt dann mit dem rechten Fuß",
            "a person waves with the left hand twice, then kicks with the right foot",
        ),
        ("Eine Person bulxt, dann wuppert sie", "a person kicks, then waves"),
        ("Eine Person winkt wuppert", "a person waves"),
    ],
)
def test_sides_numbers_and_order_of_a_word_that_the_network_reads_are_the_tables(text, english, monkeypatch):
    monkeypatch.setattr(foreign_tagger, "load_tagger", lambda: Sure(text, wuppert="{wave}", bulxt="{kick}"))
    assert translate(text).english == english
    nothing = translate("Eine Person brummelt")
    assert nothing.language == "en" and not nothing.concepts


def test_without_the_tagger_the_table_reads_alone(monkeypatch, tmp_path):
    for path in PACKAGE_WEIGHTS.glob("*.safetensors"):
        if path.stem != "tagger":
            (tmp_path / path.name).symlink_to(path)
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    concepts = scan_spaced("Eine Person wuppert und geht", "de")
    assert tagged("Eine Person wuppert und geht", "de", concepts) == concepts
    assert parse("Eine Person wuppert und geht").clauses[0].actions == ("walk",)
