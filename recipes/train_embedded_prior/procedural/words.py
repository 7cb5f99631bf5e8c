"""Names of things: every noun a caption can use, and nouns real captions are likely to use.

The list is fixed while a prior is in training: its embeddings are rows in the order of the sorted
vocabulary. A test checks that everything the generator says is covered. Words that the generator
never says are kept so that a real caption holds no unknown token; they are learned from context
or not at all.
"""

from __future__ import annotations

KITCHEN = """
mug cup coffee tea tumbler paper drinking beaker bottle water wine juice soda milk flask bowl dish
soup salad ramekin vase urn flower pot plate saucer dinner teapot kettle jug pitcher carafe goblet
glass chalice cocktail frying pan skillet saucepan cooking stew casserole spoon ladle spatula
kitchen fork knife jar cookie can tin canister container cupcake muffin cake birthday layer donut
doughnut ring tray cutting board toaster blender microwave oven stove sink faucet mixer grinder
shaker pepper salt sugar butter bread toast sandwich burger hamburger pizza ice cream cone sushi
egg cheese sausage chocolate candy lollipop popsicle cookie biscuit waffle pancake pie chopsticks
thermos barrel keg cask carton cereal packet box rack utensils melamine porcelain iced beer
"""

FURNITURE = """
chair dining seat stool bar footstool armchair lounge sofa couch settee corner table side desk
writing office work shelf bookcase bookshelf book shelving unit shoe cabinet chest drawers dresser
wardrobe cupboard closet sideboard tv refrigerator fridge washing machine washer bed double single
bench park garden crate storage bin basket open cardboard gift present treasure trunk lamp desk
floor bedside lantern chandelier ceiling light bulb candle candlestick holder clock alarm wall
mirror picture frame painting rug carpet pillow curtain door window ladder piano fireplace heater
radiator fan vacuum toilet bathtub sink television screen rocking swivel wheelchair throne ottoman
nightstand coat rack hanger trash waste bucket pail watering can broom
"""

OUTDOORS = """
house cottage home hut cabin building barn church chapel tower castle skyscraper windmill
lighthouse tent bridge temple pagoda pyramid igloo garage shed shop store school doghouse
birdhouse mailbox fence gate well fountain tree pine fir christmas palm oak plant potted pot
flower sunflower daisy tulip rose cactus succulent mushroom toadstool bush hedge leaf log stump
rock hill mountain island snowman traffic cone sign street lamp post hydrant fire tombstone
gravestone stone statue bust column pillar monument obelisk flag pole apple banana pear orange
lemon lime strawberry cherry pumpkin tomato carrot eggplant watermelon melon grapes pineapple bell
vegetable fruit potato onion cucumber corn broccoli avocado coconut peach plum
"""

VEHICLES = """
car sedan taxi cab van minivan truck pickup lorry dump tanker bus school coach tram train
locomotive engine wagon tractor excavator bulldozer plane airplane aeroplane jet helicopter boat
ship sailboat yacht rowboat canoe submarine rocket spaceship spacecraft ufo saucer flying tank
motorcycle motorbike scooter bicycle bike cart wheelbarrow sled skateboard race racing sports
police ambulance wheel tire drone balloon hot air trailer
"""

CREATURES = """
bear teddy animal dog puppy cat kitten cow horse pony pig sheep lamb goat elephant giraffe lion
tiger monkey rabbit bunny mouse duck rubber chick chicken hen rooster bird penguin owl parrot
eagle swan fish shark whale dolphin octopus crab turtle tortoise frog snake lizard dinosaur dragon
snail caterpillar bee ladybug butterfly spider ant fox wolf deer reindeer camel hippo rhino
crocodile panda koala kangaroo squirrel hedgehog seal person man woman boy girl child doll figure
figurine character soldier knight warrior king queen wizard astronaut pirate ninja robot android
alien ghost monster santa angel skeleton skull head bust statuette gnome clown cowboy chef biker
rider plush armadillo egyptian voxel seated standing pawn rook bishop chess piece unicorn squid
starfish jellyfish
"""

THINGS = """
ball soccer beach tennis basketball baseball football bowling golf volleyball toy block cube dice
die lettered building bricks domino puzzle top spinning yo-yo kite drum guitar violin ukulele
trumpet piano bell trophy award medal cup dumbbell barbell weight kettlebell racket bat skate
helmet hat cap baseball top cowboy beanie bowler sombrero witch party crown shoe boot sneaker
slipper sandal heel sock glove shirt jacket dress bag handbag purse backpack suitcase briefcase
wallet belt tie umbrella parasol glasses sunglasses goggles headset headphones earphones watch
ring necklace camera video security webcam speaker loudspeaker radio boombox microphone phone
telephone smartphone tablet computer laptop keyboard mouse monitor printer game controller gamepad
joystick remote vr virtual reality stapler scissors pen pencil marker brush eraser ruler tape
dispenser calculator globe book notebook hammer screwdriver wrench pliers saw drill axe shovel
rake toolbox flashlight torch battery plug key lock padlock chain rope hook nail screw bolt gear
magnet compass telescope binoculars microscope hourglass thermometer scale sword shield gun bow
arrow cannon bomb spray soap dispenser toothbrush comb hairdryer iron sewing cushion towel
abstract shape sculpture object solid blob lump symmetric ornament turned spindle vessel stack
pile stacked knot twisted loop spiral spring coil helix structure pattern gem crystal diamond star
heart egg sphere cylinder pyramid prism torus ring wedge arch organizer electric toy wind-up model
mascot logo letter number tile
"""

DESCRIPTIVE = """
thing item piece pair set of and in on its for from made side view part half photo picture image
render thin thick short tall long round square oval flat wide narrow low high deep shallow closed
empty full curved bent pointed sharp soft hard smooth rough shiny matte bright dark light pale
deep handle handles lid cover leg legs wheel wheels window windows door doors roof chimney shade
stem leaf leaves petals icing frosting cherry sprinkles cushions button buttons lens lenses strap
straps foot feet base top bottom edge back seat arm arms head body tail ear ears eyes eye nose
beak horn horns mane wings wing scarf brim sole laces strings letters text label labels logo face
faces hands hand knob knobs spout rim straw food flowers drawers shelves books two three four five
six seven eight no one parts bands ribbon flaps blanket linen pillows inside slatted rectangular
stripe stripes sail sails mast sleepers cockpit turret cannon ladder balcony battlements flags
thorns spots cap caps roots branches trunk candles flame glow hanging metal-rimmed low-poly
four-tier tier pages title cover spine dial numbers hand tracks bumper headlights propeller rotor
engines cargo load tank fins fin thrusters smile mouth whiskers hooves paws claws snout hat coat
tie belt backrest armrests crossed pedestal legless upholstery wheels cloth checkered plaid floral
patterned blocks lamps plates weights without grey-green blue-green reddish greenish bluish
decorated painted printed plain colorful multicolored rainbow transparent clear frosted rusty
antique modern vintage rustic ornate fancy classic cute funny happy
"""

ALL = (KITCHEN, FURNITURE, OUTDOORS, VEHICLES, CREATURES, THINGS, DESCRIPTIVE)


def name_words() -> set[str]:
    """Return the words of all lists."""
    return {word for text in ALL for word in text.split()}
