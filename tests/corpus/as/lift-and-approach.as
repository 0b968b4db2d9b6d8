; Approach from above along the tool, down, and depart again, straight and by joints.
; after: high = 40 +- 0.3
; after: down = 0 +- 0.3
; after: up = 25 +- 0.3
; after: joint.up = 50 +- 0.5
; after: hand = 0 +- 0.3
.PROGRAM main()
  SPEED 150 MM/S ALWAYS
  ACCEL 80 ALWAYS
  DECEL 80 ALWAYS
  ACCURACY 0.5 ALWAYS
  HERE grasp
  LAPPRO grasp,40
  BREAK
  high=DZ(HERE)-DZ(grasp)
  LMOVE grasp
  BREAK
  down=DZ(HERE)-DZ(grasp)
  LDEPART 25
  BREAK
  up=DZ(HERE)-DZ(grasp)
  JAPPRO grasp,30
  JDEPART 20
  BREAK
  joint.up=DZ(HERE)-DZ(grasp)
  HMOVE grasp
  STABLE 0.2
  BREAK
  hand=DISTANCE(HERE,grasp)
.END
