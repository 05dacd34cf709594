;;; anmech: enclosures of motions, step by step.
;;;
;;; Of a step from a set of states, a box of all states on the way comes first: with the Taylor polynomial of the order
;;; K - 1 at the set and the coefficient K at a larger box B, if the polynomial plus s^K times that coefficient lies
;;; inside of B for all parts s of the step, then every motion that begins in the set exists during the step and stays
;;; in B.  For let t be the last time until which it does: until then Taylor's formula holds, its rest with a
;;; coefficient from B, so at t it is inside of B, not on the border, and goes on.  At the end of the step, x is the
;;; polynomial at the center, plus the coefficient from B, plus the derivatives of the polynomial, anywhere in the set,
;;; times what is left to the center (enclosure_frames.lisp).
;;;
;;; Of each step, a *link* is kept: what is between its ends is found again for whoever asks.
;;;
;;; Entry points: the structures ENCLOSURE and LINK; NEW-ENCLOSURE, ENCLOSE-MOTION, ENCLOSED-STATES, MIDDLE-STATES,
;;; WIDTH-AT-END, SIZES-UNTIL.
;;;
;;; Literature: R. J. Lohner (1987), see enclosure_frames.lisp; G. F. Corliss, R. Rihm, Validating an a priori enclosure
;;; using high-order Taylor series, in: Scientific Computing and Validated Numerics (1996) 228-238; N. S. Nedialkov,
;;; K. R. Jackson, G. F. Corliss, Applied Mathematics and Computation 105 (1999) 21-68.

(in-package :anmech)
(needs "session/patience" "arithmetic/floats" "numerics/ball_series" "numerics/balls" "numerics/dag"
       "numerics/enclosure_frames" "numerics/long_numbers" "numerics/sharing")

(defstruct link
  time step                 ; of the step, rational numbers
  center frame scales radii ; of the set: integers; scales: binary logarithms
  box                       ; radii of the states
  rest                      ; balls: coefficient K from the box on the way
  coefficients              ; of the states at the center: for each order a list of balls
  field)                    ; the varied one

(defstruct (enclosure (:print-function print-dots))
  bits size-bits order n    ; see balls.lisp, ball_series.lisp
  central plain varied      ; ball fields: at the center, on the way, and with derivatives in the set
  (links nil)               ; vector
  (sizes nil)               ; the largest size of each state, in units: no smaller one
  (ends nil)                ; the same where steps end: no larger one
  inputs solved             ; balls of what is given, and the program of rates and unknowns: for those who read it
  (renew (constantly nil))  ; function (enclosure): another program of the same rates that is better where it has come
                            ; to, and its places; or nil
  wanted                    ; the accuracy
  (start 0)                 ; where it begins
  time center frame scales radii box      ; at the end
  (widest 0)                ; the largest radius of a state in proportion to its size where steps end
  (evaluations 0) (rejected 0)
  (trouble nil)             ; what has ended it: a condition, :interrupted, :too-many-steps, :too-short, :too-wide,
                            ; :too-large
  (step-before nil)         ; the length of the last step but one
  (needed-before nil)       ; and the part of what was permitted that it needed
  (expanded nil)            ; the step in which the varied field counts its time; nil: it is to be expanded
  (read nil))               ; the last link that was read

(defun new-enclosure (program places n inputs bits order small)
  "Where numbers have BITS binary places, of which the first SMALL may be 0 in all of them; INPUTS are balls of the
states, the time and the parameters; PROGRAM is one of the rates and their derivatives."
  (let ((enclosure (make-enclosure :bits bits :size-bits (+ *size-bits* small) :order order :n n :inputs inputs
                                   :center (map 'vector #'ball-middle (subseq inputs 0 n))
                                   :frame (unit-frame n) :scales (make-array n :initial-element 0)
                                   :radii (map 'vector #'ball-radius (subseq inputs 0 n))
                                   :box (map 'vector #'ball-radius (subseq inputs 0 n))
                                   :sizes (map 'vector #'ball-size (subseq inputs 0 n))
                                   :ends (map 'vector (lambda (input) (abs (ball-middle input)))
                                              (subseq inputs 0 n)))))
    (use-program enclosure program places)
    enclosure))

(defun use-program (enclosure program places)
  "Go on by PROGRAM, of the rates and their derivatives, which have PLACES."
  (let* ((n (enclosure-n enclosure)) (order (enclosure-order enclosure)) (inputs (enclosure-inputs enclosure))
         (rates (make-program :instructions (program-instructions program) :guards (program-guards program)
                              :results (subseq (program-results program) 0 n))))
    (setf (enclosure-central enclosure) (new-ball-field rates n inputs order :thin t)
          (enclosure-plain enclosure) (new-ball-field rates n inputs order)
          (enclosure-varied enclosure) (new-ball-field program n inputs order :places places :thin t)
          (enclosure-expanded enclosure) nil)))

(defun box-of (center radii) (map 'list #'ball center radii))

(defun time-ball (time step)
  "From TIME to TIME + STEP."
  (let ((a (ball-of time)) (b (ball-of (+ time step))))
    (ball-between (min (ball-low a) (ball-low b)) (max (ball-high a) (ball-high b)))))

;;; On the way

(defparameter *parts* 4 "A polynomial is enclosed in so many parts of a step.")

(defun range-on-the-way (field i order part)
  "A ball that holds the polynomial of state I everywhere in a step, PART of that in which the coefficients count."
  (let ((coefficients (loop for k from 1 to order
                            collect (ball-product (state-coefficient field i k) (ball-of (expt part k)))))
        (low nil) (high nil))
    (dotimes (place *parts* (ball-between low high))
      (let ((sum (state-coefficient field i 0)))
        (loop for coefficient in coefficients
              for k from 1
              do (setq sum (ball-sum sum (ball-within-part coefficient place k))))
        (setq low (if low (min low (ball-low sum)) (ball-low sum))
              high (if high (max high (ball-high sum)) (ball-high sum)))))))

(defun ball-within-part (coefficient place k)
  "The ball of COEFFICIENT times s^K, s between PLACE and PLACE + 1 in parts."
  (let ((from (expt place k)) (to (expt (1+ place) k)) (whole (expt *parts* k)))
    (let ((low (min (* from (ball-low coefficient)) (* to (ball-low coefficient))))
          (high (max (* from (ball-high coefficient)) (* to (ball-high coefficient)))))
      (ball-between (floor low whole) (ceiling high whole)))))

(defun expanded-part (enclosure step)
  "Which part STEP is of that in which the varied field counts its time; it is expanded unless one of about that length
is at hand."
  (let ((expanded (enclosure-expanded enclosure)))
    (unless (and expanded (<= 1/8 (/ step expanded) 1))
      (setf (enclosure-expanded enclosure) nil)
      (expand-balls (enclosure-varied enclosure) (box-of (enclosure-center enclosure) (enclosure-box enclosure))
                    (ball-of (enclosure-time enclosure)) step (1- (enclosure-order enclosure)))
      (incf (enclosure-evaluations enclosure) (enclosure-order enclosure))
      (setf (enclosure-expanded enclosure) step))
    (/ step (enclosure-expanded enclosure))))

(defun permitted-units (size tolerance)
  "What is added to the range of a state of such a SIZE."
  (+ 16 (ceiling-quotient (* size (numerator tolerance)) (denominator tolerance))))

(defun attempted-step (enclosure step tolerance)
  "The balls of coefficient K, the sizes, and the largest part of what is permitted that was needed: below 1 the step is
proved."
  (let* ((n (enclosure-n enclosure)) (order (enclosure-order enclosure)) (time (enclosure-time enclosure))
         (varied (enclosure-varied enclosure)) (plain (enclosure-plain enclosure))
         (part (expanded-part enclosure step)))
    (let* ((ranges (loop for i below n collect (range-on-the-way varied i (1- order) part)))
           (sizes (map 'vector #'max (enclosure-sizes enclosure) (mapcar #'ball-size ranges)))
           (permitted (map 'list (lambda (size) (permitted-units size tolerance)) sizes)))
      (expand-balls plain (mapcar #'wider-ball ranges permitted) (time-ball time step) step order)
      (incf (enclosure-evaluations enclosure) order)
      (let ((rest (loop for i below n collect (state-coefficient plain i order))))
        (values rest sizes
                (loop for ball in rest for units in permitted maximize (/ (ball-size ball) units)))))))

;;; The end of a step

(defun variation-sums (enclosure varied part)
  "The derivatives of the polynomial of the field VARIED at PART of the step, a rational number: a matrix of balls."
  (let* ((n (enclosure-n enclosure)) (matrix (make-array (* n n)))
         (order (1- (enclosure-order enclosure))))
    (dotimes (i n matrix)
      (dotimes (j n)
        (setf (svref matrix (+ j (* i n)))
              (series-value (lambda (k) (variation-coefficient varied i j k)) order part))))))

(defun series-value (coefficient order part)
  "The sum of the balls COEFFICIENT (k) times PART^k, k = 0 .. ORDER."
  (let ((sum (funcall coefficient order)))
    (loop for k from (1- order) downto 0
          do (setq sum (ball-sum (funcall coefficient k) (if (= part 1) sum (ball-in-steps sum part 1)))))
    sum))

(defun kept-coefficients (enclosure step)
  "Those of the states at the center, from order 0 on: a vector of lists."
  (let ((central (enclosure-central enclosure)) (n (enclosure-n enclosure)) (order (enclosure-order enclosure)))
    (expand-balls central (map 'list (lambda (middle) (ball middle 0)) (enclosure-center enclosure))
                  (ball-of (enclosure-time enclosure)) step (1- order))
    (incf (enclosure-evaluations enclosure) order)
    (coerce (loop for k below order collect (loop for i below n collect (state-coefficient central i k))) 'vector)))

(defun center-at (link part)
  "Balls of the states that the center has moved to at PART of the step, with the rest."
  (let* ((coefficients (link-coefficients link)) (order (length coefficients)))
    (loop for rest in (link-rest link)
          for i from 0
          collect (series-value (lambda (k) (if (= k order) rest (nth i (svref coefficients k)))) order part))))

(defun scales-of (sizes bits)
  (map 'vector (lambda (size) (if (zerop size) 0 (- (integer-length size) bits))) sizes))

(defun carry-to-end (enclosure step rest sizes)
  "Go to the end of a STEP that is proved, with such a REST."
  (let* ((n (enclosure-n enclosure)) (bits (enclosure-bits enclosure))
         (link (make-link :time (enclosure-time enclosure) :step step :center (enclosure-center enclosure)
                          :frame (enclosure-frame enclosure) :scales (enclosure-scales enclosure)
                          :radii (enclosure-radii enclosure) :box (enclosure-box enclosure) :rest rest
                          :coefficients (kept-coefficients enclosure step) :field (enclosure-varied enclosure)))
         (scales (scales-of sizes bits)) (balls (center-at link 1))
         (errors (map 'vector #'ball-radius balls)) (matrix (variation-sums enclosure (enclosure-varied enclosure)
                                                                     (expanded-part enclosure step)))
         (radii (enclosure-radii enclosure))
         (map (matrix-in-frame matrix (enclosure-frame enclosure) (enclosure-scales enclosure) scales n))
         (scaled-errors (map 'vector #'scaled-radius errors scales)))
    (setf (enclosure-box enclosure)
          (map 'vector (lambda (radius scale error) (+ error (scaled-radius radius (- scale))))
               (radii-of-map map radii n) scales errors))
    (multiple-value-bind (frame found) (best-frame map radii scaled-errors n)
      (setf (enclosure-frame enclosure) frame (enclosure-radii enclosure) found))
    (setf (enclosure-expanded enclosure) nil
          (enclosure-scales enclosure) scales
          (enclosure-sizes enclosure) sizes
          (enclosure-center enclosure) (map 'vector #'ball-middle balls)
          (enclosure-time enclosure) (+ (enclosure-time enclosure) step))
    (note-width enclosure)
    link))

(defun scaled-radius (radius scale)
  "RADIUS over 2^SCALE."
  (if (minusp scale) (ash radius (- scale)) (ceiling-shift radius scale)))

(defun best-frame (map radii errors n)
  "An orthogonal matrix and the radii in it; that of the axes where no other is good."
  (let* ((frame (new-frame map radii n)) (found (radii-in-frame frame map radii errors n)))
    (if found
        (values frame found)
        (values (unit-frame n) (radii-in-frame (unit-frame n) map radii errors n)))))

(defun note-width (enclosure)
  (setf (enclosure-ends enclosure)
        (map 'vector (lambda (size middle) (max size (abs middle)))
             (enclosure-ends enclosure) (enclosure-center enclosure))
        (enclosure-widest enclosure) (max (enclosure-widest enclosure) (width-at-end enclosure))))

(defun width-at-end (enclosure)
  "The largest radius of a state in proportion to its size so far, a rational number."
  (loop for radius across (enclosure-box enclosure)
        for size across (enclosure-ends enclosure)
        for least across (least-sizes enclosure)
        maximize (/ radius (max size least))))

(defparameter *least-size-bits* 44 "A smaller state is hardly told from 0: binary logarithm, in units.")

(defun least-sizes (enclosure)
  "What states count for that are smaller where steps end: a millionth of what they may have been between."
  (map 'vector (lambda (possible) (max (ceiling possible 1000000) (ash 1 *least-size-bits*)))
       (enclosure-sizes enclosure)))

(defun sizes-until (enclosure time)
  "The largest size of each state where steps begin, until TIME: rational numbers."
  (let ((sizes (coerce (least-sizes enclosure) 'list)) (unit (ash 1 (enclosure-bits enclosure)))
        (way (abs (- time (enclosure-start enclosure)))))
    (loop for link across (enclosure-links enclosure)
          while (<= (abs (- (link-time link) (enclosure-start enclosure))) way)
          do (setq sizes (map 'list (lambda (size middle) (max size (abs middle))) sizes (link-center link))))
    (mapcar (lambda (size) (/ size unit)) sizes)))

;;; Steps

(defparameter *step-places* 12 "Steps have so many binary places of their own.")
(defparameter *shortest-part* (expt 2 -60) "Of the way: no step is shorter.")
(defparameter *largest-bits* 1020 "What doubles hold.")
(defparameter *too-wide* 1/8 "In proportion to its size, a state whose radius is larger is lost.")

(defun short-number (number)
  "A rational number not larger than NUMBER in size, of few bits."
  (if (zerop number)
      0
      (let ((unit (expt 2 (- (floor (binary-logarithm number)) *step-places*))))
        (* (signum number) unit (floor (abs number) unit)))))

(defun step-factor (needed order)
  "By what a step is to be changed that NEEDED such a part of what was permitted."
  (let ((logarithm (/ (- -3 (if (zerop needed) -1000 (binary-logarithm needed))) order)))
    (rational (expt 2d0 (max -4d0 (min 1d0 logarithm))))))

(defparameter *longer-in-noise* 9/8)

(defun next-step (enclosure step factor needed)
  "After STEP, which NEEDED such a part of what is permitted and might have been longer by FACTOR; shorter again where
steps become shorter, unless this one needed as much as a longer one: that is what was cut off, which no step avoids."
  (let ((before (enclosure-step-before enclosure)) (needed-before (enclosure-needed-before enclosure)))
    (setf (enclosure-step-before enclosure) step (enclosure-needed-before enclosure) needed)
    (short-number (* step (cond ((null before) factor)
                                ((and (< factor 1) (< step before) (>= needed needed-before)) *longer-in-noise*)
                                (t (* factor (max 1/2 (min 1 (/ step before))))))))))

(defun enclose-step (enclosure step end tolerance)
  "Take one step, of the length STEP if it can be proved, else a shorter one: its link and the length of the next; or
nil, and the trouble."
  (let* ((left (- end (enclosure-time enclosure))) (shortest (* *shortest-part* (abs left))) (trouble :too-short))
    (loop
      (when (< (abs step) shortest) (return (values nil trouble)))
      (poll)
      (when (>= (abs step) (abs left)) (setq step left))
      (let ((factor (handler-case
                        (multiple-value-bind (rest sizes needed) (attempted-step enclosure step tolerance)
                          (let ((factor (step-factor needed (enclosure-order enclosure)))
                                (large (> (reduce #'max sizes) (ash 1 (+ *largest-bits* (enclosure-bits enclosure))))))
                            (when large (setq trouble :too-large))
                            (when (and (< needed 1) (not large))
                              (return (values (carry-to-end enclosure step rest sizes)
                                              (next-step enclosure step factor needed))))
                            (min 3/4 factor)))
                      (domain-violation (condition) (setq trouble condition) 1/2))))
        (incf (enclosure-rejected enclosure))
        (setq step (short-number (* step factor)))))))

(defparameter *steps-of-program* 4 "After so many it is looked whether another one is better.")

(defun enclose-motion (enclosure start end tolerance most-steps progress)
  "From START to END, rational numbers."
  (let ((*ball-bits* (enclosure-bits enclosure)) (*size-bits* (enclosure-size-bits enclosure))
        (links (make-array 64 :adjustable t :fill-pointer 0))
        (step (- end start)))
    (setf (enclosure-start enclosure) start (enclosure-time enclosure) start)
    (loop until (= (enclosure-time enclosure) end)
          do (when (zerop (rem (1+ (length links)) *steps-of-program*))
               (multiple-value-bind (program places) (funcall (the function (enclosure-renew enclosure)) enclosure)
                 (when program (use-program enclosure program places))))
             (when (setf (enclosure-trouble enclosure)
                         (cond ((interrupted-p) :interrupted)
                               ((>= (length links) most-steps) :too-many-steps)
                               ((> (width-at-end enclosure) *too-wide*) :too-wide)
                               (t (multiple-value-bind (link next) (enclose-step enclosure step end tolerance)
                                    (cond (link (vector-push-extend link links) (setq step next) nil)
                                          (t next))))))
               (return))
             (when progress
               (funcall progress (to-double (/ (- (enclosure-time enclosure) start) (- end start))))))
    (setf (enclosure-links enclosure) (coerce links 'simple-vector))
    enclosure))

;;; Reading

(defun link-place (enclosure time)
  (let* ((links (enclosure-links enclosure)) (low 0) (high (1- (length links)))
         (forward (<= (link-time (svref links 0)) (enclosure-time enclosure))))
    (loop while (< low high)
          do (let* ((middle (ceiling (+ low high) 2)) (there (link-time (svref links middle))))
               (if (if forward (<= there time) (>= there time))
                   (setq low middle)
                   (setq high (1- middle)))))
    low))

(defun enclosed-states (enclosure time)
  "Balls of the states at TIME, a rational number between the ends."
  (let ((*ball-bits* (enclosure-bits enclosure)) (*size-bits* (enclosure-size-bits enclosure)))
    (if (= time (enclosure-time enclosure))
        (box-of (enclosure-center enclosure) (enclosure-box enclosure))
        (let* ((link (svref (enclosure-links enclosure) (link-place enclosure time)))
               (part (/ (- time (link-time link)) (link-step link))))
          (if (zerop part)
              (box-of (link-center link) (link-box link))
              (states-within enclosure link part))))))

(defun states-within (enclosure link part)
  (let ((n (enclosure-n enclosure)) (balls (center-at link part)) (scales (link-scales link)))
    (unless (eq link (enclosure-read enclosure))
      (setf (enclosure-read enclosure) nil)
      (expand-balls (link-field link) (box-of (link-center link) (link-box link))
                    (ball-of (link-time link)) (link-step link) (1- (enclosure-order enclosure)))
      (setf (enclosure-read enclosure) link))
    (let ((map (matrix-in-frame (variation-sums enclosure (link-field link) part) (link-frame link) scales scales n)))
      (loop for ball in balls
            for radius across (radii-of-map map (link-radii link) n)
            for scale across scales
            collect (wider-ball ball (scaled-radius radius (- scale)))))))

(defun middle-states (enclosure time)
  "The midpoints of the same, but for the width of the set."
  (let ((*ball-bits* (enclosure-bits enclosure)))
    (if (= time (enclosure-time enclosure))
        (map 'list #'ball-value (enclosure-center enclosure))
        (let* ((link (svref (enclosure-links enclosure) (link-place enclosure time)))
               (part (/ (- time (link-time link)) (link-step link))))
          (mapcar (lambda (ball) (ball-value (ball-middle ball)))
                  (if (zerop part) (box-of (link-center link) (link-box link)) (center-at link part)))))))
